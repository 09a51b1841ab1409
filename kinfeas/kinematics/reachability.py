"""Reachability: the share of goals that the EE reaches from some base pose."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS, Proportion, wilson
from kinfeas.core.spatial import Array, planar_pose, relative, rotation
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.free_space import connected, footprint
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.kinematics.solids import base_collides, in_base
from kinfeas.robots.robot import Robot

STAGES = (4, 16, 64, 256, 1024)
"""Base poses tried around a goal by the end of each stage."""

_POSTURES, _POSTURE_SEED = 8192, 3


@dataclass(frozen=True)
class Reachability:
    """Reached goals.

    Attributes:
        reached: Whether a base pose was found for each goal, shape (n,).
        share: Share of reached goals with its Wilson interval.
        convergence: Share reached by the end of each stage.
    """

    reached: NDArray[np.bool_]
    share: Proportion
    convergence: tuple[float, ...]


def at_goals(robot: Robot, ik: IkOptions) -> IkOptions:
    """Return the IK options for goals: tolerances of success replace a pose tolerance."""
    if robot.pose_tolerance is None or not ik.pose_tolerance:
        return ik
    return replace(
        ik, pose_tolerance=False, position_tolerance=GOAL_METRES, rotation_tolerance=GOAL_RADIANS
    )


def reachable(
    solver: IkSolver,
    goals: Array,
    stages: Sequence[int] = STAGES,
    on_done: Callable[[float], None] | None = None,
    tried: int = 0,
    start: Start | None = None,
) -> Reachability:
    """Return which of `goals` the EE reaches from some base pose.

    Base poses come from configurations spread over the joint limits: the robot is turned and moved
    until its EE is above or below the goal. Configurations with the least error in height and tilt
    come first, and IK decides. Goals that are not found are out of reach only if `convergence` has
    settled.

    Args:
        solver: IK, with its tolerances and self-collision check.
        goals: World poses of the EE, shape (n, 7), n at least 1.
        stages: Ascending numbers of base poses; only open goals enter the next stage.
        on_done: Called with the share of all work, 0-1, that has just been done.
        tried: Number of base poses that were tried before.
        start: Starts with the solids of each goal: then base and arm must be free of them, and the
            base pose must be connected with the start for a disc within the base.
    """
    postures = Postures(solver)
    reached = np.zeros(len(goals), dtype=np.bool_)
    convergence = []
    for first, last in zip((tried, *stages), stages, strict=False):
        still_open = np.flatnonzero(~reached)
        for row in still_open:
            among = None if start is None else start.of(np.array([row]))
            reached[row] = postures.reach(goals[row], first, last, among)
            if on_done is not None:
                on_done(1.0 / (len(still_open) * len(stages)))
        convergence.append(float(reached.mean()))
    return Reachability(reached, wilson(int(reached.sum()), len(reached)), tuple(convergence))


class Postures:
    """Arm configurations without self-collision that propose base poses."""

    def __init__(self, solver: IkSolver) -> None:
        joints = spread_configurations(solver.robot, _POSTURES, _POSTURE_SEED)
        self.solver = solver
        self.joints = joints[~self_collides(solver.collision, joints)]
        self.ee_pose = forward(solver.chain, self.joints)
        self.turns = rotation(self.ee_pose).as_matrix()
        self.footprint = footprint(solver.collision)

    def reach(self, goal: Array, first: int, last: int, start: Start | None = None) -> bool:
        """Return whether one of the proposals `first` to `last` reaches `goal`, shape (7,)."""
        base, joints = self.around(goal, first, last)
        solids = None
        if start is not None and start.solids is not None:
            solids = start.solids.repeated(len(base))
            free = ~base_collides(self.solver.collision, base, solids)
            free &= connected(start.solids, start.base_pose[0, :2], base[:, :2], self.footprint)
            rows = np.flatnonzero(free)
            base, joints = base[rows], joints[rows]
            solids = in_base(solids.of(rows), base)
        targets = relative(np.broadcast_to(goal, base.shape), base)
        return bool(np.any(self.solver.solve(targets, joints, solids=solids).feasible))

    def around(self, goal: Array, first: int, last: int) -> tuple[Array, Array]:
        """Return the proposals for `goal`: base poses, shape (m, 7), and arms, shape (m, j).

        Their headings maximize the trace of R_goal' Rz(heading) R_ee.
        """
        # R_ee R_goal' as one product of matrices: many small ones take ten times as long.
        product = (self.turns.reshape(-1, 3) @ rotation(goal).as_matrix().T).reshape(-1, 3, 3)
        cosine = product[:, 0, 0] + product[:, 1, 1]
        sine = product[:, 0, 1] - product[:, 1, 0]
        tilt = 3.0 - np.hypot(cosine, sine) - product[:, 2, 2]
        cost = (self.ee_pose[:, 2] - goal[2]) ** 2 + ROTATION_WEIGHT**2 * tilt
        best = _smallest(cost, last)[first:]
        heading, ee = np.arctan2(sine[best], cosine[best]), self.ee_pose[best]
        cosine, sine = np.cos(heading), np.sin(heading)
        x = goal[0] - (cosine * ee[:, 0] - sine * ee[:, 1])
        y = goal[1] - (sine * ee[:, 0] + cosine * ee[:, 1])
        return planar_pose(x, y, heading), self.joints[best]


def _smallest(values: Array, count: int) -> NDArray[np.intp]:
    """Return the places of the smallest values, (n,), in ascending order, at most `count`."""
    near = np.arange(len(values))
    if count < len(values):
        near = np.argpartition(values, count)[:count]
    return near[np.argsort(values[near])]
