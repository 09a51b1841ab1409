"""Base poses from which the EE reaches goals, and the fraction of goals that it reaches."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinfeas.core.kernels import kernel
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS, Proportion, wilson
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, planar_pose, relative, rotation
from kinfeas.kinematics.convex import add_support
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import CollisionModel
from kinfeas.kinematics.solids import base_collides, in_base
from kinfeas.planning.base_lattice import driving_costs
from kinfeas.robots.robot import Robot

STAGES: tuple[int, ...] = (4, 16, 64, 256, 1024)
"""Base poses tried around a goal by the end of each stage."""


@dataclass(frozen=True)
class PlacementSettings:
    """Settings of the search for base poses."""

    postures: int = 8192  # arm configurations that propose base poses
    seed: int = 3  # seed of these configurations
    cell: float = 0.1  # side of a cell of the floor, metres
    border: float = 3.0  # width of the floor around all solids, the start and the goals, metres
    detour: float = 30.0  # distance from start and goals to which solids widen this floor, metres
    directions: int = 64  # number of directions in which the extent of the base is measured


_SETTINGS = PlacementSettings()


@dataclass(frozen=True)
class Reachability:
    """Reached goals.

    `limits` has, for each sub-goal, numbers of goals out of reach by a key of `reach.LIMITS`; empty
    if these are not counted.
    """

    reached: NDArray[np.bool_]  # whether a base pose was found for each goal, shape (n,)
    share: Proportion  # fraction of reached goals with its Wilson interval
    convergence: tuple[float, ...]  # fraction of goals reached by the end of each stage
    limits: tuple[dict[str, int], ...] = ()


def at_goals(robot: Robot, ik: IkOptions) -> IkOptions:
    """Return the IK options for goals: tolerances of success replace a pose tolerance."""
    if robot.pose_tolerance is None or not ik.pose_tolerance:
        return ik
    return replace(
        ik, pose_tolerance=False, position_tolerance=GOAL_METRES, rotation_tolerance=GOAL_RADIANS
    )


def reachable(solver: IkSolver, goals: Array, stages: Sequence[int] = STAGES) -> Reachability:
    """Return which of `goals` the EE reaches from some base pose.

    Goals that are not found are out of reach only if `convergence` has settled.

    Args:
        solver: IK, with its tolerances and self-collision check.
        goals: World poses of the EE, shape (n, 7), n at least 1.
        stages: Ascending numbers of base poses to try around a goal.
    """
    postures = Postures(solver)
    return reachability(np.array([postures.tries(goal, stages) for goal in goals]), stages)


def reachability(tries: Array, stages: Sequence[int]) -> Reachability:
    """Return the reachability of n goals from their `Postures.tries`, shape (n,)."""
    reached = np.isfinite(tries)
    convergence = tuple(float(np.mean(tries <= stage)) for stage in stages)
    return Reachability(reached, wilson(int(reached.sum()), len(reached)), convergence)


class Postures:
    """Arm configurations that propose base poses, admissible unless self-collision is ignored.

    They are spread over the joint limits. For each, the base is turned and moved until the EE is
    above or below a goal. Proposals with the least error in height and tilt are tried first, by IK.
    """

    def __init__(self, solver: IkSolver) -> None:
        joints = spread_configurations(solver.robot, _SETTINGS.postures, _SETTINGS.seed)
        self.solver, self._local_solver = solver, solver.local()
        checked = solver.options.self_collision
        self.joints = joints[solver.admissible(joints)] if checked else joints
        self.ee_pose = forward(solver.chain, self.joints)
        self.rotations = rotation(self.ee_pose).as_matrix()
        self.footprint = footprint(solver.collision)

    def tries(
        self,
        goal: Array,
        stages: Sequence[int],
        solids: Solids | None = None,
        start: Array | None = None,
    ) -> float:
        """Return the first of `stages`, numbers of proposals, that reaches a goal, or inf.

        Stages ascend; other arguments are those of `reaching`.
        """
        for numbers in pairwise((0, *stages)):
            if len(self.reaching(goal, numbers, solids, start)[0]):
                return numbers[1]
        return np.inf

    def reaching(
        self,
        goal: Array,
        numbers: tuple[int, int],
        solids: Solids | None = None,
        start: Array | None = None,
        *,
        restarts: bool = True,
    ) -> tuple[Array, Array]:
        """Return base poses, shape (m, 7), from which the arm reaches a goal, and arms, (m, j).

        Args:
            goal: World pose of the EE, shape (7,).
            numbers: Range of proposals to try, first and end, where the best is number 0.
            solids: In the world, one row, of which base and arm must be free.
            start: World pose of the base, shape (7,), from which a disc within the base must be
                able to drive to the base poses among the solids.
            restarts: Whether IK also begins elsewhere than at the proposed arms, which takes most
                of the time.
        """
        base, joints = self._around(goal, *numbers)
        among = None
        if solids is not None:
            free = ~base_collides(self.solver.collision, base, solids.repeated(len(base)))
            base, joints = base[free], joints[free]
            among = in_base(solids.repeated(len(base)), base)
        solver = self.solver if restarts else self._local_solver
        arm = solver.solve(relative(goal, base), joints, solids=among)
        base, joints = base[arm.feasible], arm.joint_positions[arm.feasible]
        if start is None or solids is None or not len(base):
            return base, joints
        accessible = connected(solids, start[:2], base[:, :2], self.footprint)
        return base[accessible], joints[accessible]

    def _around(self, goal: Array, first: int, last: int) -> tuple[Array, Array]:
        """Return the proposals for `goal`: base poses, shape (m, 7), and arms, shape (m, j).

        Their headings maximize the trace of R_goal' Rz(heading) R_ee.
        """
        # R_ee R_goal' as one product of matrices: many small ones take ten times as long.
        product = (self.rotations.reshape(-1, 3) @ rotation(goal).as_matrix().T).reshape(-1, 3, 3)
        cosine = product[:, 0, 0] + product[:, 1, 1]
        sine = product[:, 0, 1] - product[:, 1, 0]
        tilt = 3.0 - np.hypot(cosine, sine) - product[:, 2, 2]
        cost = (self.ee_pose[:, 2] - goal[2]) ** 2 + ROTATION_WEIGHT**2 * tilt
        best = np.argpartition(cost, last)[:last] if last < len(cost) else np.arange(len(cost))
        best = best[np.argsort(cost[best])][first:]
        heading, ee = np.arctan2(sine[best], cosine[best]), self.ee_pose[best]
        cosine, sine = np.cos(heading), np.sin(heading)
        x = goal[0] - (cosine * ee[:, 0] - sine * ee[:, 1])
        y = goal[1] - (sine * ee[:, 0] + cosine * ee[:, 1])
        return planar_pose(x, y, heading), self.joints[best]


def footprint(model: CollisionModel) -> tuple[float, float]:
    """Return radius and height of a disc, metres, that the convex hull of the base contains.

    The disc is around the origin of the base frame, seen from above; its height is that of the
    lowest shape.
    """
    angle = 2.0 * np.pi / _SETTINGS.directions * np.arange(_SETTINGS.directions)
    around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    *aside, down = _extents(model, np.vstack([around, [0.0, 0.0, -1.0]])).tolist()
    return max(min(aside), 0.0), max(-down if np.isfinite(down) else 0.0, 0.0)


@kernel
def _extents(model, directions):
    """Return how far the shapes on the base extend in unit directions, (d, 3) -> (d,), metres."""
    extents, point = np.full(len(directions), -np.inf), np.empty(3)
    for d in range(len(directions)):
        direction = directions[d]
        for s in range(len(model.body)):
            if model.body[s] < 0:
                shape = model.kind[s], model.size[s], model.rotation[s], model.offset[s]
                point[:] = 0.0
                add_support(point, 1.0, 1.0, direction, *shape)
                extent = 0.0
                for i in range(3):
                    extent += direction[i] * point[i]
                extents[d] = max(extents[d], extent)
    return extents


def connected(
    solids: Solids, start: Array, positions: Array, disc: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return whether a disc can be driven from a start to positions, shape (m,).

    The answer is optimistic by the width of a cell. Moving solids are left out; paths that lead
    farther than `detour` from start and positions are not found.

    Args:
        solids: In the world, one row.
        start: Position of the disc, shape (2,), metres.
        positions: Positions to reach, shape (m, 2), metres.
        disc: Its radius and height, metres.
    """
    standing = solids.filled[0] & ~solids.velocity[0].any(axis=1)
    centre, half = solids.pose[0, standing, :2], solids.size[0, standing, :2]
    half = np.linalg.norm(half, axis=1, keepdims=True)
    ends, detour = np.vstack([start, positions]), _SETTINGS.detour
    corners = np.vstack([centre - half, centre + half, ends])
    corners = corners.clip(ends.min(axis=0) - detour, ends.max(axis=0) + detour)
    low, high = corners.min(axis=0) - _SETTINGS.border, corners.max(axis=0) + _SETTINGS.border
    smaller = disc[0] - _SETTINGS.cell, disc[1]
    cost = driving_costs(solids, low, high, _SETTINGS.cell, smaller)
    labels, _ = ndimage.label(np.isfinite(cost))
    cells = np.rint((ends - low) / _SETTINGS.cell).astype(np.intp)
    region = labels[cells[:, 0], cells[:, 1]]
    return (region[1:] == region[0]) & (region[0] > 0)
