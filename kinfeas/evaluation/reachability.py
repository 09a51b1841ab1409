"""Reachability of the goals and paths of a task: the upper bound (ceiling) of success."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.execution import SubgoalMotion
from kinfeas.control.observation import HORIZON
from kinfeas.control.subgoal_motions import LONGEST, SubgoalMotions, begin_motions, subgoal_ends
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start, episode_rng, stacked
from kinfeas.kinematics.ik import IkOptions, IkSolver
from kinfeas.planning.placement import STAGES, Postures, Reachability, at_goals, reachability
from kinfeas.planning.reach import BasePlacer
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import StreamTask, Task, build_subgoals, sample_start

WAYPOINT_STAGES = STAGES[:4]
"""Numbers of base poses that have been tried around a waypoint at the end of each stage."""

WAYPOINTS = 16
"""Poses along a sub-goal."""

_MAX_PERIODS = round(LONGEST / HORIZON)

OnDone = Callable[[float], None]


@dataclass(frozen=True)
class ReachabilityConfig:
    """Parameters of the task and settings of IK in a measurement."""

    task: dict[str, object] = field(default_factory=dict)
    ik: IkOptions = field(default_factory=IkOptions)


def measure_reachability(  # noqa: PLR0913 - an evaluation and how to run it
    robot: Robot,
    task: Task,
    episodes: int,
    seed: int,
    ik: IkOptions | None = None,
    on_done: OnDone | None = None,
    *,
    path: bool = False,
    limits: bool = False,
) -> Reachability:
    """Return for each episode whether some base pose reaches the goals of all sub-goals.

    A robot with pose tolerance reaches a goal within the tolerance of success, others exactly.
    Base and arm must be free of all solids; moving ones are where they start. A disc within the
    base must be able to drive from the start to the base pose among the solids that stand. The
    episodes are those of an evaluation. With `path`, base poses must also reach all waypoints; each
    may have its own, and base motions between them are not checked. `on_done` is called with the
    fraction of work, 0-1, that has just been done. With `limits`, the limits that keep sub-goals
    out of reach are counted, too.
    """
    if isinstance(task, StreamTask):
        raise KinfeasError(f"task {task.name!r} has no ceiling: its targets move")
    options = ik or IkOptions()
    solver = IkSolver(robot, at_goals(robot, options))
    subgoals, starts, rngs = _starts(solver, task, episodes, seed)
    groups = [(Postures(solver), subgoal_ends(solver, subgoals, starts, rngs), STAGES)]
    if path:
        solver = IkSolver(robot, options)
        waypoints = draw_waypoints(solver, task, episodes, seed)
        groups.append((Postures(solver), waypoints, WAYPOINT_STAGES))
    tries = [np.empty(poses.shape[:2]) for _, poses, _ in groups]
    for (postures, poses, stages), group_tries in zip(groups, tries, strict=True):
        for episode, number in np.ndindex(group_tries.shape):
            start = starts.of(np.array([episode]))
            around = start.solids, start.base_pose[0]
            group_tries[episode, number] = postures.tries(poses[episode, number], stages, *around)
            if on_done is not None:
                on_done(1.0 / sum(map(np.size, tries)))
    counts = _limits(groups, tries, starts) if limits else ()
    most = np.concatenate(tries, axis=1).max(axis=1)
    return replace(reachability(most, STAGES), limits=counts)


def _limits(
    groups: Sequence[tuple[Postures, Array, Sequence[int]]],
    tries: Sequence[Array],
    starts: Start,
) -> tuple[dict[str, int], ...]:
    """Return the numbers of episodes in which each sub-goal is out of reach, by limit.

    The limit is that of the first pose out of reach: the goal, then the waypoints.
    """
    goals = tries[0]  # shape (episodes, sub-goals)
    counts: tuple[Counter[str], ...] = tuple(Counter() for _ in goals.T)
    missed_before = np.zeros((len(goals), len(counts)), dtype=np.bool_)
    for (postures, poses, _), group_tries in zip(groups, tries, strict=True):
        reachable = np.isfinite(group_tries).reshape(*missed_before.shape, -1)
        episodes, numbers = np.nonzero(~reachable.all(axis=2) & ~missed_before)
        missed_before[episodes, numbers] = True
        if episodes.size:
            first = numbers * reachable.shape[2] + np.argmin(reachable[episodes, numbers], axis=1)
            solver, missed = postures.solver, poses[episodes, first]
            placer = BasePlacer(solver.robot, solver.options)
            for number, episode, pose in zip(numbers.tolist(), episodes, missed, strict=True):
                start = starts.of(np.array([episode]))
                counts[number][placer.limit(pose, start.solids, start.base_pose[0])] += 1
    return tuple(dict(count) for count in counts)


def draw_waypoints(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return desired EE poses along each sub-goal, shape (episodes, sub-goals * WAYPOINTS, 7).

    They are evenly spaced in time and end within the tolerance of the sub-goal, where the next one
    begins.
    """
    subgoals, starts, rngs = _starts(solver, task, episodes, seed)
    motions = begin_motions(solver, subgoals, starts, rngs)
    if starts.solids is not None:
        motions.avoid(starts.solids, None, (starts.base_pose, starts.joint_positions))
    steps = list(_follow(motions))
    desired, subgoal = (np.stack(column, 1) for column in zip(*steps, strict=True))
    moments = [
        np.concatenate([_spread(row, number) for number in range(len(motions.subgoals))])
        for row in subgoal
    ]
    return np.take_along_axis(desired, np.stack(moments)[:, :, np.newaxis], axis=1)


def _starts(
    solver: IkSolver, task: Task, episodes: int, seed: int
) -> tuple[tuple[SubgoalMotion, ...], Start, list[np.random.Generator]]:
    """Return the sub-goals of a task, and starts and random generators of its episodes."""
    rngs = [episode_rng(seed, episode) for episode in range(episodes)]
    starts = [sample_start(task, solver, rng) for rng in rngs]
    return build_subgoals(task.subgoals), stacked(starts), rngs


def _follow(motions: SubgoalMotions) -> Iterator[tuple[Array, NDArray[np.intp]]]:
    """Yield the desired poses after each period, (n, 7), and their sub-goals; -1 after the last."""
    left = np.full(len(motions.subgoal), _MAX_PERIODS)
    finished = np.zeros(len(left), dtype=np.bool_)
    while not finished.all():
        subgoal = motions.subgoal
        motions.move(motions.step_of(HORIZON))
        yield motions.desired, np.where(finished, -1, subgoal)
        metres, radians = spatial.distance(motions.desired, motions.goal)
        left -= 1
        # A motion that does not arrive must not stop the others.
        near = (metres <= GOAL_METRES) & (radians <= GOAL_RADIANS)
        ends = motions.ended(near) | (left <= 0)
        finished |= ends & motions.last
        left[ends] = _MAX_PERIODS
        motions.begin_next(ends)


def _spread(subgoal: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    """Return the indices of `WAYPOINTS` periods, evenly spaced up to the last, of a sub-goal."""
    moments = np.flatnonzero(subgoal == number)
    return moments[np.arange(1, WAYPOINTS + 1) * len(moments) // WAYPOINTS - 1]
