"""The ceiling of a task: what no policy can beat."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from kinfeas.core.metrics import wilson
from kinfeas.core.spatial import Array
from kinfeas.evaluation.waypoints import draw_goals, draw_waypoints
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.reachability import STAGES, Reachability, at_goals, reachable
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import Task

MOST_ALONG_THE_WAY = 256
"""Base poses that are tried around a pose along the way."""

OnDone = Callable[[float], None]


@dataclass(frozen=True)
class ReachabilityConfig:
    """What can be set of a ceiling beside robot, task and seed.

    Attributes:
        task: Keyword parameters of the task.
        ik: How hard IK searches, and whether the robot may touch itself.
    """

    task: dict[str, object] = field(default_factory=dict)
    ik: IkOptions = field(default_factory=IkOptions)


@dataclass(frozen=True, eq=False)
class _Poses:
    """What has to be reached in n episodes.

    Attributes:
        solver: Says what counts as reached.
        poses: World poses of the EE, shape (n, k, 7).
        most: Base poses to try around each.
    """

    solver: IkSolver
    poses: Array
    most: int = STAGES[-1]


def measure_reachability(
    robot: Robot,
    task: Task,
    episodes: int,
    seed: int,
    ik: IkOptions | None = None,
    on_done: OnDone | None = None,
) -> Reachability:
    """Return in which of the first episodes some base pose reaches the goals of all sub-goals.

    A robot with pose tolerance has to come as near to the goals as success asks for; all others
    have to reach them exactly, free of self-collision like every solution.

    Args:
        robot: Who moves.
        task: Draws the goals, the same ones as in an evaluation.
        episodes: How many, at least 1.
        seed: Of the episodes.
        ik: How hard IK searches, and whether the robot may touch itself.
        on_done: Called with the share of all work, 0-1, that has just been done.
    """
    return _reached([_goals(robot, task, episodes, seed, ik)], on_done)


def measure_path_reachability(
    robot: Robot,
    task: Task,
    episodes: int,
    seed: int,
    ik: IkOptions | None = None,
    on_done: OnDone | None = None,
) -> Reachability:
    """Return as `measure_reachability`, with the poses on the way to be reached as well.

    A robot with pose tolerance has it there. That the base can move from the one base pose to the
    next is not asked for. Arguments as in `measure_reachability`.
    """
    solver = IkSolver(robot, ik or IkOptions())
    way = _Poses(solver, draw_waypoints(solver, task, episodes, seed), MOST_ALONG_THE_WAY)
    return _reached([_goals(robot, task, episodes, seed, ik), way], on_done)


def _goals(robot: Robot, task: Task, episodes: int, seed: int, ik: IkOptions | None) -> _Poses:
    solver = IkSolver(robot, at_goals(robot, ik or IkOptions()))
    return _Poses(solver, draw_goals(solver, task, episodes, seed))


def _reached(groups: Sequence[_Poses], on_done: OnDone | None) -> Reachability:
    """Return in which episodes all poses of all groups are reached."""
    report = on_done or (lambda _: None)
    reached = [np.zeros(group.poses.shape[:2], dtype=np.bool_) for group in groups]
    episodes, work = len(reached[0]), len(groups) * len(STAGES)
    convergence = []
    for tried, stage in zip((0, *STAGES), STAGES, strict=False):
        for group, found in zip(groups, reached, strict=True):
            still_open = ~found
            if stage > group.most or not still_open.any():
                report(1.0 / work)
                continue
            found[still_open] = reachable(
                group.solver,
                group.poses[still_open],
                (stage,),
                lambda done: report(done / work),
                tried,
            ).reached
        all_reached = np.all([found.all(axis=1) for found in reached], axis=0)
        convergence.append(float(all_reached.mean()))
    return Reachability(all_reached, wilson(int(all_reached.sum()), episodes), tuple(convergence))
