"""What a run is going to ask of arm and base, looked at before anything moves."""

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace

import numpy as np

from kinfeas import spatial
from kinfeas.course import Course
from kinfeas.errors import KinfeasError
from kinfeas.kinematics.ceiling import reachable
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import GOAL_METRES, GOAL_RADIANS
from kinfeas.loop import Loop
from kinfeas.observation import HORIZON
from kinfeas.sim2real.guard_config import Guards
from kinfeas.spatial import Array
from kinfeas.start import Start

_LONGEST = 1500
"""Periods of `HORIZON` for which the motion of a leg is followed at most."""

_ROUNDING = 1e-6
"""By which a speed in m/s, or a quotient of two, may be off."""


def preview(loop: Loop, start: Start, rng: np.random.Generator, guards: Guards) -> str:
    """Return a warning of what is likely to end a run early, or nothing.

    Args:
        loop: What is going to be started.
        start: Where it begins, with leading axes of one.
        rng: What it is going to draw from, which stays as it is.
        guards: What is allowed.

    Raises:
        KinfeasError: If the end of a leg is out of reach, as far as a search can tell.
    """
    if guards.reach:
        _check_reach(loop.solver, leg_ends(_course(loop, start, rng)))
    if guards.speed is None:
        return ""
    planned = top_speed(_course(loop, start, rng))
    paced = planned / loop.pace.slow_down
    if paced <= guards.speed + _ROUNDING:
        return ""
    share = max(planned, loop.robot.base.max_velocity) / guards.speed
    return (
        f"guards.speed slows down the base alone, to {guards.speed:g} m/s; the hand, which is to "
        f"move at up to {paced:.2g} m/s, may leave it behind: "
        f"--set slow_down={math.ceil(share - _ROUNDING)} slows it down as much"
    )


def leg_ends(course: Course) -> Array:
    """Return the world poses of the EE at the ends of all legs of one robot, shape (legs, 7)."""
    return np.concatenate([course.goal for _ in _each_leg(course)])


def top_speed(course: Course) -> float:
    """Return the greatest speed in m/s at which one robot's EE is planned to move."""
    return max(_top_speed_of_leg(course) for _ in _each_leg(course))


def _course(loop: Loop, start: Start, rng: np.random.Generator) -> Course:
    """Return the course that a loop is going to take, without waits and a head start."""
    legs = [replace(leg, wait=0.0) for leg in loop.course.legs]
    course = Course(legs, loop.robot, HORIZON)
    ee = spatial.compose(start.base_pose, forward(loop.solver.chain, start.joint_positions))
    course.start(ee, start.target_poses, [deepcopy(rng)])
    return course


def _each_leg(course: Course) -> Iterator[int]:
    """Yield the number of each leg at its start, as if each one before led to its very end."""
    for number in range(len(course.legs)):
        yield number
        course.desired = course.goal
        course.advance(np.ones(1, dtype=np.bool_))


def _top_speed_of_leg(course: Course) -> float:
    fastest = 0.0
    for _ in range(_LONGEST):
        before = course.desired
        course.move(course.ahead(HORIZON))
        moved, _ = spatial.distance(course.desired, before)
        fastest = max(fastest, moved.item() / HORIZON)
        metres, radians = spatial.distance(course.desired, course.goal)
        if metres.item() <= GOAL_METRES and radians.item() <= GOAL_RADIANS:
            break
    return fastest


def _check_reach(solver: IkSolver, goals: Array) -> None:
    """Do nothing if base poses are found from which the arm comes to all `goals`, shape (n, 7).

    It may stay as far away as counts as there.
    """
    near = replace(
        solver.options,
        leeway=False,
        position_tolerance=max(solver.options.position_tolerance, GOAL_METRES),
        rotation_tolerance=max(solver.options.rotation_tolerance, GOAL_RADIANS),
    )
    reached = reachable(IkSolver(solver.robot, near), goals).reached
    if reached.all():
        return
    first = int(np.argmin(reached))
    what = "the goal" if len(goals) == 1 else f"the end of leg {first + 1} of {len(goals)}"
    raise KinfeasError(
        f"no base pose was found from which the arm reaches {what}, {_words(goals[first])}; "
        "--set guards.reach=false goes there all the same"
    )


def _words(pose: Array) -> str:
    """Return a pose, shape (7,), as one reads it."""
    turn = spatial.rotation(pose).as_euler("xyz")
    x, y, z, roll, pitch, yaw = (f"{value + 0.0:g}" for value in np.round([*pose[:3], *turn], 3))
    return f"x {x}, y {y}, z {z} m, roll {roll}, pitch {pitch}, yaw {yaw} rad"
