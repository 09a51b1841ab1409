"""What a run is going to ask of arm and base, looked at before anything moves."""

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace

import numpy as np

from kinfeas.control.loop import Loop
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import HORIZON
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.reachability import reachable
from kinfeas.sim2real.deploy.guard_config import Guards

_LONGEST = 1500
"""Periods of `HORIZON` for which the motion of a sub-goal is followed at most."""

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
        KinfeasError: If the end of a sub-goal is out of reach, as far as a search can tell.
    """
    if guards.reach:
        _check_reach(loop.solver, subgoal_poses(_sequence(loop, start, rng)))
    if guards.max_linear_velocity is None:
        return ""
    planned = top_speed(_sequence(loop, start, rng))
    execution_of = planned * loop.execution.time_scale
    if execution_of <= guards.max_linear_velocity + _ROUNDING:
        return ""
    share = guards.max_linear_velocity / max(planned, loop.robot.base.max_velocity)
    return (
        f"guards.max_linear_velocity slows down the base alone, to "
        f"{guards.max_linear_velocity:g} m/s; the hand, which is to "
        f"move at up to {execution_of:.2g} m/s, may leave it behind: "
        f"--set time_scale={math.floor(100 * share + _ROUNDING) / 100:g} slows it down as much"
    )


def subgoal_poses(sequence: MotionSequence) -> Array:
    """Return one robot's EE poses at the ends of all sub-goals, shape (sub-goals, 7)."""
    return np.concatenate([sequence.goal for _ in _each_subgoal(sequence)])


def top_speed(sequence: MotionSequence) -> float:
    """Return the greatest speed in m/s at which one robot's EE is planned to move."""
    return max(_top_speed_of_subgoal(sequence) for _ in _each_subgoal(sequence))


def _sequence(loop: Loop, start: Start, rng: np.random.Generator) -> MotionSequence:
    """Return the motion sequence that a loop is going to take, without waits and a head start."""
    subgoals = [replace(subgoal, dwell=0.0) for subgoal in loop.sequence.subgoals]
    sequence = MotionSequence(subgoals, loop.robot, HORIZON)
    ee = spatial.compose(start.base_pose, forward(loop.solver.chain, start.joint_positions))
    sequence.start(ee, start.target_poses, [deepcopy(rng)])
    return sequence


def _each_subgoal(sequence: MotionSequence) -> Iterator[int]:
    """Yield the number of each sub-goal at its start, as if each one before led to its very end."""
    for number in range(len(sequence.subgoals)):
        yield number
        sequence.desired = sequence.goal
        sequence.advance(np.ones(1, dtype=np.bool_))


def _top_speed_of_subgoal(sequence: MotionSequence) -> float:
    fastest = 0.0
    for _ in range(_LONGEST):
        before = sequence.desired
        sequence.move(sequence.plan(HORIZON))
        moved, _ = spatial.distance(sequence.desired, before)
        fastest = max(fastest, moved.item() / HORIZON)
        metres, radians = spatial.distance(sequence.desired, sequence.goal)
        if metres.item() <= GOAL_METRES and radians.item() <= GOAL_RADIANS:
            break
    return fastest


def _check_reach(solver: IkSolver, goals: Array) -> None:
    """Do nothing if base poses are found from which the arm comes to all `goals`, shape (n, 7).

    It may stay as far away as counts as there.
    """
    near = replace(
        solver.options,
        pose_tolerance=False,
        position_tolerance=max(solver.options.position_tolerance, GOAL_METRES),
        rotation_tolerance=max(solver.options.rotation_tolerance, GOAL_RADIANS),
    )
    reached = reachable(IkSolver(solver.robot, near), goals).reached
    if reached.all():
        return
    first = int(np.argmin(reached))
    what = "the goal" if len(goals) == 1 else f"the end of sub-goal {first + 1} of {len(goals)}"
    raise KinfeasError(
        f"no base pose was found from which the arm reaches {what}, {_words(goals[first])}; "
        "--set guards.reach=false goes there all the same"
    )


def _words(pose: Array) -> str:
    """Return a pose, shape (7,), as one reads it."""
    turn = spatial.rotation(pose).as_euler("xyz")
    x, y, z, roll, pitch, yaw = (f"{value + 0.0:g}" for value in np.round([*pose[:3], *turn], 3))
    return f"x {x}, y {y}, z {z} m, roll {roll}, pitch {pitch}, yaw {yaw} rad"
