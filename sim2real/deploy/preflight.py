"""Checks before a run: reachable goals, limits that fit the motion, and compiled kernels."""

import math
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from kinfeas.config import PluginSpec
from kinfeas.control.loop import Loop
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import HORIZON
from kinfeas.core import registry, spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.policy import CommandFilter, Policy
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.reachability import reachable
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.tasks.task import Task, build_subgoals

_LONGEST = 1500  # steps of `HORIZON` for which the motion to a sub-goal is computed
_ROUNDING = 1e-6  # of velocities in m/s and of their quotients

_WARM_UP_STEPS = 5
_WARM_UP_WAY = np.array([0.5, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0])  # m, from the EE to its targets


def preflight(loop: Loop, start: Start, rng: np.random.Generator, guards: Guards) -> str:
    """Return a warning if the EE is planned to outrun the base, or an empty string.

    The loop has not started; `start` has leading axes of one; `rng` is not advanced.

    Raises:
        KinfeasError: If no base pose is found from which the arm reaches the end of a sub-goal.
    """
    if guards.reach:
        sequence = _sequence(loop, start, rng)
        _check_reach(loop.solver, np.concatenate([sequence.goal for _ in _each_subgoal(sequence)]))
    most = guards.max_linear_velocity
    if most is None:
        return ""
    planned = top_speed(_sequence(loop, start, rng))
    executed = planned * loop.execution.time_scale
    if executed <= most + _ROUNDING:
        return ""
    share = most / max(planned, loop.robot.base.max_velocity)
    scale = math.floor(100 * share + _ROUNDING) / 100
    return (
        f"guards.max_linear_velocity limits the base to {most:g} m/s, but the EE is planned to "
        f"move at up to {executed:.2g} m/s and may outrun it: --set time_scale={scale:g} slows both"
    )


def top_speed(sequence: MotionSequence) -> float:
    """Return the highest planned velocity of one robot's EE, m/s."""
    fastest = 0.0
    for _ in _each_subgoal(sequence):
        for _ in range(_LONGEST):
            before = sequence.desired
            sequence.move(sequence.plan(HORIZON))
            moved, _ = spatial.distance(sequence.desired, before)
            fastest = max(fastest, moved.item() / HORIZON)
            metres, radians = spatial.distance(sequence.desired, sequence.goal)
            if metres.item() <= GOAL_METRES and radians.item() <= GOAL_RADIANS:
                break
    return fastest


def warm_up(
    solver: IkSolver,
    policy: Policy,
    task: Task,
    dt: float,
    adapters: Sequence[PluginSpec] = (),
    filters: Sequence[CommandFilter] = (),
) -> None:
    """Compile the kernels of a run by a few steps in the analytic world."""
    robot, rng = solver.robot, np.random.default_rng(0)
    joints = robot.home["home"][np.newaxis]
    target = forward(solver.chain, joints) + _WARM_UP_WAY
    targets = np.stack([target] * len(task.subgoals), axis=1)
    analytic = registry.build("kinfeas.backends", "analytic", {})
    backend = Guarded(analytic, robot, Guards().timeless(), adapters=adapters)
    loop = Loop(solver, build_subgoals(task.subgoals), backend, dt, filters=filters)
    loop.set_policy(policy)
    loop.start(Start(spatial.IDENTITY[np.newaxis], joints, targets), [rng])
    for _ in range(_WARM_UP_STEPS):
        loop.step(policy.act(loop.policy_input))


def _sequence(loop: Loop, start: Start, rng: np.random.Generator) -> MotionSequence:
    """Return the motion sequence of a loop without dwell times and head start."""
    subgoals = [replace(subgoal, dwell=0.0) for subgoal in loop.sequence.subgoals]
    sequence = MotionSequence(subgoals, loop.robot, HORIZON)
    ee = spatial.compose(start.base_pose, forward(loop.solver.chain, start.joint_positions))
    sequence.start(ee, start.target_poses, [deepcopy(rng)])
    return sequence


def _each_subgoal(sequence: MotionSequence) -> Iterator[int]:
    """Yield the number of each sub-goal; the one before ends exactly at its goal."""
    for number in range(len(sequence.subgoals)):
        yield number
        sequence.desired = sequence.goal
        sequence.advance(np.ones(1, dtype=np.bool_))


def _check_reach(solver: IkSolver, goals: Array) -> None:
    """Raise KinfeasError for the first of the goals, shape (n, 7), that the arm cannot reach."""
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
    goal = "the goal" if len(goals) == 1 else f"the end of sub-goal {first + 1} of {len(goals)}"
    rpy = spatial.rotation(goals[first]).as_euler("xyz")
    numbers = (f"{value + 0.0:g}" for value in np.round([*goals[first, :3], *rpy], 3))
    x, y, z, roll, pitch, yaw = numbers
    raise KinfeasError(
        f"no base pose was found from which the arm reaches {goal}, x {x}, y {y}, z {z} m, roll "
        f"{roll}, pitch {pitch}, yaw {yaw} rad; --set guards.reach=false skips this check"
    )
