"""Where the motions of a task lead: the ends of their sub-goals, and poses along the way."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import HORIZON
from kinfeas.core import spatial
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.spatial import Array
from kinfeas.core.start import episode_rng
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.task import Task, build_subgoals, sample_start

A_SUBGOAL = 16
"""Poses along a sub-goal."""

_PERIODS = 1500
"""Control periods for which the motion of one sub-goal is followed at most."""


def draw_goals(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return the EE poses at the ends of all sub-goals, shape (episodes, sub-goals, 7).

    Args:
        solver: The robot's kinematics.
        task: Draws episodes 0 to `episodes` - 1.
        episodes: How many.
        seed: Of the episodes.
    """
    sequence = _begin(solver, task, episodes, seed)
    everyone = np.ones(episodes, dtype=np.bool_)
    goals = []
    for _ in sequence.subgoals:
        goals.append(sequence.goal)
        # As if each sub-goal led to its very end.
        sequence.desired = goals[-1]
        sequence.advance(everyone)
    return np.stack(goals, axis=1)


def draw_waypoints(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return desired EE poses along each sub-goal, shape (episodes, sub-goals * A_SUBGOAL, 7).

    They are evenly spaced in time and end where the sub-goal counts as ended; a sub-goal begins
    there, as it does for an EE that follows without an error. Arguments as in `draw_goals`.
    """
    sequence = _begin(solver, task, episodes, seed)
    steps = list(_follow(sequence))
    desired, subgoal = (
        np.stack([pose for pose, _ in steps], 1),
        np.stack([subgoal for _, subgoal in steps], 1),
    )
    chosen = [
        np.concatenate([_spread(row, number) for number in range(len(sequence.subgoals))])
        for row in subgoal
    ]
    return np.take_along_axis(desired, np.stack(chosen)[:, :, np.newaxis], axis=1)


def _begin(solver: IkSolver, task: Task, episodes: int, seed: int) -> MotionSequence:
    """Return the motions of the episodes at their start, without waits."""
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
        # A motion that does not arrive must not keep the others from going on.
        ends = ((metres <= GOAL_METRES) & (radians <= GOAL_RADIANS)) | (left <= 0)
        finished |= ends & sequence.last
        left[ends] = _PERIODS
        sequence.advance(ends)


def _spread(subgoal: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    """Return `A_SUBGOAL` moments at which `subgoal`, shape (t,), is `number`, the last included.

    The first one is not: an episode begins at a pose that the arm is at.
    """
    moments = np.flatnonzero(subgoal == number)
    return moments[np.arange(1, A_SUBGOAL + 1) * len(moments) // A_SUBGOAL - 1]
