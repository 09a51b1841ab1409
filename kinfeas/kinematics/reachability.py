"""The ceiling: how many goals can be reached from any base pose at all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS, Share, wilson
from kinfeas.core.spatial import Array, planar_pose, relative, rotation
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkOptions, IkSolver, spread_configurations
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.robot import Robot

STAGES = (4, 16, 64, 256, 1024)
"""Base poses that have been tried around an open goal by the end of each stage."""

_POSTURES, _POSTURE_SEED = 8192, 3


@dataclass(frozen=True)
class Reachability:
    """What can be reached, and how sure that is.

    Attributes:
        reached: For each goal whether a base pose was found, shape (n,).
        share: Share of them with its Wilson interval: how well n goals stand for all goals.
        convergence: Share reached by the end of each stage: how little more tries still add.
    """

    reached: NDArray[np.bool_]
    share: Share
    convergence: tuple[float, ...]


def at_goals(robot: Robot, ik: IkOptions) -> IkOptions:
    """Return the IK options at goals, where success limits a robot's pose tolerance."""
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
) -> Reachability:
    """Return which of `goals` the EE reaches from some base pose.

    The base poses to try come from postures spread over the joint limits: each is turned about and
    carried over the floor until its EE is above or below the goal, and those that miss the goal's
    height and tilt least come first. IK decides. What it finds is certain; a goal that it does not
    find is as good as out of reach only where `convergence` has settled.

    Args:
        solver: Says what counts as reached, and whether self-collision does not.
        goals: World poses of the EE, shape (n, 7), n at least 1.
        stages: Ascending numbers of base poses; only goals still open go on to the next stage.
        on_done: Called with the share of all work, 0-1, that has just been done.
        tried: Of the base poses, how many have been tried in vain already.
    """
    postures = _Postures(solver)
    reached = np.zeros(len(goals), dtype=np.bool_)
    convergence = []
    for first, last in zip((tried, *stages), stages, strict=False):
        still_open = np.flatnonzero(~reached)
        for row in still_open:
            reached[row] = postures.reach(goals[row], first, last)
            if on_done is not None:
                on_done(1.0 / (len(still_open) * len(stages)))
        convergence.append(float(reached.mean()))
    return Reachability(reached, wilson(int(reached.sum()), len(reached)), tuple(convergence))


class _Postures:
    """Arm configurations free of self-collision that propose base poses."""

    def __init__(self, solver: IkSolver) -> None:
        joints = spread_configurations(solver.robot, _POSTURES, _POSTURE_SEED)
        self.solver = solver
        self.joints = joints[~self_collides(solver.collision, joints)]
        self.ee_pose = forward(solver.chain, self.joints)
        self.turns = rotation(self.ee_pose).as_matrix()

    def reach(self, goal: Array, first: int, last: int) -> bool:
        """Return whether one of the proposals `first` to `last` for `goal`, (7,), reaches it."""
        heading, cost = self._face(goal)
        best = np.argsort(cost, kind="stable")[first:last]
        heading, ee = heading[best], self.ee_pose[best]
        cosine, sine = np.cos(heading), np.sin(heading)
        x = goal[0] - (cosine * ee[:, 0] - sine * ee[:, 1])
        y = goal[1] - (sine * ee[:, 0] + cosine * ee[:, 1])
        base = planar_pose(x, y, heading)
        targets = relative(np.broadcast_to(goal, base.shape), base)
        return bool(np.any(self.solver.solve(targets, self.joints[best]).feasible))

    def _face(self, goal: Array) -> tuple[Array, Array]:
        """Return for each posture the heading that fits `goal` best, and the squared miss, (l,).

        The heading maximizes the trace of R_goal' Rz(heading) R_ee.
        """
        product = np.einsum("ij,lkj->lik", rotation(goal).as_matrix(), self.turns)
        cosine = product[:, 0, 0] + product[:, 1, 1]
        sine = product[:, 1, 0] - product[:, 0, 1]
        trace = np.hypot(cosine, sine) + product[:, 2, 2]
        height = self.ee_pose[:, 2] - goal[2]
        return np.arctan2(sine, cosine), height**2 + ROTATION_WEIGHT**2 * (3.0 - trace)
