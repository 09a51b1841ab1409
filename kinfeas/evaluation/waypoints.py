"""Where the motions of a task lead: the ends of their legs, and poses along the way."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinfeas import spatial
from kinfeas.course import Course
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import GOAL_METRES, GOAL_RADIANS
from kinfeas.observation import HORIZON
from kinfeas.spatial import Array
from kinfeas.start import episode_rng
from kinfeas.tasks.task import Task, build_legs

A_LEG = 16
"""Poses along a leg."""

_PERIODS = 1500
"""Control periods for which the motion of one leg is followed at most."""


def draw_goals(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return the world poses of the EE at the ends of all legs, shape (episodes, legs, 7).

    Args:
        solver: The robot's kinematics.
        task: Draws episodes 0 to `episodes` - 1.
        episodes: How many.
        seed: Of the episodes.
    """
    course = _begin(solver, task, episodes, seed)
    everyone = np.ones(episodes, dtype=np.bool_)
    goals = []
    for _ in course.legs:
        goals.append(course.goal)
        # As if each leg led to its very end.
        course.desired = goals[-1]
        course.advance(everyone)
    return np.stack(goals, axis=1)


def draw_waypoints(solver: IkSolver, task: Task, episodes: int, seed: int) -> Array:
    """Return `A_LEG` desired EE poses for each leg, shape (episodes, legs * A_LEG, 7).

    They are evenly spaced in time and end where the leg counts as ended; a leg begins there, as it
    does for an EE that follows without an error. Arguments as in `draw_goals`.
    """
    course = _begin(solver, task, episodes, seed)
    steps = list(_follow(course))
    desired, leg = np.stack([pose for pose, _ in steps], 1), np.stack([leg for _, leg in steps], 1)
    chosen = [
        np.concatenate([_spread(row, number) for number in range(len(course.legs))]) for row in leg
    ]
    return np.take_along_axis(desired, np.stack(chosen)[:, :, np.newaxis], axis=1)


def _begin(solver: IkSolver, task: Task, episodes: int, seed: int) -> Course:
    """Return the motions of the episodes at their start, without waits."""
    rngs = [episode_rng(seed, episode) for episode in range(episodes)]
    starts = [task.sample(solver, rng) for rng in rngs]
    base = np.stack([start.base_pose for start in starts])
    joints = np.stack([start.joint_positions for start in starts])
    legs = [replace(leg, wait=0.0) for leg in build_legs(task.legs)]
    course = Course(legs, solver.robot, HORIZON)
    ee = spatial.compose(base, forward(solver.chain, joints))
    course.start(ee, np.stack([start.target_poses for start in starts]), rngs)
    return course


def _follow(course: Course) -> Iterator[tuple[Array, NDArray[np.intp]]]:
    """Yield the desired poses after each period, shape (n, 7), and the legs they are part of."""
    left = np.full(len(course.leg), _PERIODS)
    finished = np.zeros(len(left), dtype=np.bool_)
    while not finished.all():
        leg = course.leg
        course.move(course.ahead(HORIZON))
        yield course.desired, np.where(finished, -1, leg)
        metres, radians = spatial.distance(course.desired, course.goal)
        left -= 1
        # A motion that does not arrive must not keep the others from going on.
        ends = ((metres <= GOAL_METRES) & (radians <= GOAL_RADIANS)) | (left <= 0)
        finished |= ends & course.last
        left[ends] = _PERIODS
        course.advance(ends)


def _spread(leg: NDArray[np.intp], number: int) -> NDArray[np.intp]:
    """Return `A_LEG` of the moments at which `leg`, shape (t,), is `number`, the last among them.

    The first one is not: an episode begins at a pose that the arm is at.
    """
    moments = np.flatnonzero(leg == number)
    return moments[np.arange(1, A_LEG + 1) * len(moments) // A_LEG - 1]
