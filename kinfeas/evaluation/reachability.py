"""Reachability of the goals and paths of a task: the upper bound (ceiling) of success."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import HORIZON
from kinfeas.core import spatial
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS, wilson
from kinfeas.core.spatial import Array
from kinfeas.core.start import episode_rng
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.kinematics.reachability import STAGES, Reachability, at_goals, reachable
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import Task, build_subgoals, sample_start

MOST_ALONG_THE_WAY = 256
"""Base poses to try around a waypoint."""

A_SUBGOAL = 16
"""Poses along a sub-goal."""

_PERIODS = 1500
"""Longest motion of a sub-goal, in control periods."""

OnDone = Callable[[float], None]


@dataclass(frozen=True)
class ReachabilityConfig:
    """Parameters of the task and settings of IK in a measurement."""

    task: dict[str, object] = field(default_factory=dict)
    ik: IkOptions = field(default_factory=IkOptions)


@dataclass(frozen=True, eq=False)
class _Poses:
    """EE poses (n, k, 7) of n episodes, their solver, and the base poses to try around each."""

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
    """Return for each episode whether some base pose reaches the goals of all sub-goals.

    A robot with pose tolerance reaches a goal within the tolerance of success, others exactly. The
    episodes are those of an evaluation. `on_done` is called with the share of all work, 0-1, that
    has just been done.
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
    """Return for each episode whether some base poses reach all waypoints and goals.

    Each pose may have its own base pose; base motions between them are not checked. Arguments as in
    `measure_reachability`.
    """
    solver = IkSolver(robot, ik or IkOptions())
    way = _Poses(solver, draw_waypoints(solver, task, episodes, seed), MOST_ALONG_THE_WAY)
    return _reached([_goals(robot, task, episodes, seed, ik), way], on_done)


def _goals(robot: Robot, task: Task, episodes: int, seed: int, ik: IkOptions | None) -> _Poses:
    solver = IkSolver(robot, at_goals(robot, ik or IkOptions()))
    return _Poses(solver, draw_goals(solver, task, episodes, seed))


def _reached(groups: Sequence[_Poses], on_done: OnDone | None) -> Reachability:
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


def draw_goals(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return the EE poses at the ends of all sub-goals, shape (episodes, sub-goals, 7)."""
    sequence = _begin(solver, task, episodes, seed)
    everyone = np.ones(episodes, dtype=np.bool_)
    goals = []
    for _ in sequence.subgoals:
        goals.append(sequence.goal)
        # Without the tolerance at the end of a sub-goal.
        sequence.desired = goals[-1]
        sequence.advance(everyone)
    return np.stack(goals, axis=1)


def draw_waypoints(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return desired EE poses along each sub-goal, shape (episodes, sub-goals * A_SUBGOAL, 7).

    They are evenly spaced in time and end within the tolerance of the sub-goal, where the next one
    begins.
    """
    sequence = _begin(solver, task, episodes, seed)
    steps = list(_follow(sequence))
    desired, subgoal = (np.stack(each, 1) for each in zip(*steps, strict=True))
    chosen = [
        np.concatenate([_spread(row, number) for number in range(len(sequence.subgoals))])
        for row in subgoal
    ]
    return np.take_along_axis(desired, np.stack(chosen)[:, :, np.newaxis], axis=1)


def _begin(solver: IkSolver, task: Task, episodes: int, seed: int) -> MotionSequence:
    """Return the motions of the episodes at their start, without dwells."""
    rngs = [episode_rng(seed, episode) for episode in range(episodes)]
    starts = [sample_start(task, solver, rng) for rng in rngs]
    base = np.stack([start.base_pose for start in starts])
    joints = np.stack([start.joint_positions for start in starts])
    subgoals = [replace(subgoal, dwell=0.0) for subgoal in build_subgoals(task.subgoals)]
    sequence = MotionSequence(subgoals, solver.robot, HORIZON)
    ee = spatial.compose(base, forward(solver.chain, joints))
    sequence.start(ee, np.stack([start.target_poses for start in starts]), rngs)
    return sequence


def _follow(sequence: MotionSequence) -> Iterator[tuple[Array, NDArray[np.intp]]]:
    """Yield the desired poses after each period, shape (n, 7), and their sub-goals."""
    left = np.full(len(sequence.subgoal), _PERIODS)
    finished = np.zeros(len(left), dtype=np.bool_)
    while not finished.all():
        subgoal = sequence.subgoal
        sequence.move(sequence.plan(HORIZON))
        yield sequence.desired, np.where(finished, -1, subgoal)
        metres, radians = spatial.distance(sequence.desired, sequence.goal)
        left -= 1
        # A motion that does not arrive must not stop the others.
        ends = ((metres <= GOAL_METRES) & (radians <= GOAL_RADIANS)) | (left <= 0)
        finished |= ends & sequence.last
        left[ends] = _PERIODS
        sequence.advance(ends)


def _spread(subgoal: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    """Return `A_SUBGOAL` moments of a sub-goal, its last included and the start excluded."""
    moments = np.flatnonzero(subgoal == number)
    return moments[np.arange(1, A_SUBGOAL + 1) * len(moments) // A_SUBGOAL - 1]
