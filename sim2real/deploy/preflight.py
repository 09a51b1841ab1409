"""Checks before a run: reachable goals, and compiled kernels."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from kinfeas.config import PluginSpec, registry
from kinfeas.control.assemble import assemble, build_backend
from kinfeas.control.loop import Loop
from kinfeas.control.period import CommandFilter
from kinfeas.control.subgoal_motions import subgoal_ends
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.policy import Policy
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.reach import BasePlacer
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.tasks.task import Task, build_subgoals

_WARM_UP_STEPS = 5
_WARM_UP_MOTION = np.array([0.5, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0])  # m, from the EE to its targets
_WARM_UP_SOLIDS = Solids.from_table(np.array([[0.0, 3.0, 0, 0.2, 0.2, 0, 1, 0, 0, 0, 0]]))  # a box


def preflight(loop: Loop, start: Start, rng: np.random.Generator, guards: Guards) -> str:
    """Return a warning if the EE may outrun the base, or an empty string.

    `start` is a batch of one; `rng` is not advanced. Raises KinfeasError if no base pose is found
    from which the arm reaches the end of a sub-goal.
    """
    if guards.reach:
        goals = subgoal_ends(loop.solver, loop.sequence.subgoals, start, [deepcopy(rng)])
        _check_reach(loop.solver, goals[0])
    fastest = loop.robot.base.max_velocity
    scale = (guards.max_linear_velocity or fastest) / fastest
    if scale >= loop.execution.time_scale:
        return ""
    return (
        f"guards.max_linear_velocity limits the base to {scale:.0%} of its velocity, but the EE "
        f"moves at {loop.execution.time_scale:.0%}: the setting time_scale={scale:.2g} slows it"
    )


def warm_up(
    solver: IkSolver,
    policy: Policy,
    task: Task,
    dt: float,
    adapters: Sequence[PluginSpec] = (),
    filters: Sequence[PluginSpec | CommandFilter] = (),
) -> None:
    """Compile the kernels of a run by a few steps in the analytic world.

    Adapters for some backends only are left out.
    """
    robot, rng = solver.robot, np.random.default_rng(0)
    joints = robot.home["home"][np.newaxis]
    target = forward(solver.chain, joints) + _WARM_UP_MOTION
    targets = np.stack([target] * len(task.subgoals), axis=1)
    analytic = build_backend("analytic", {}, robot=robot)
    kinds = [(spec, registry.load("kinfeas.adapters", spec.name)) for spec in adapters]
    general = [spec for spec, kind in kinds if not getattr(kind, "needs", "")]
    backend = Guarded(analytic, robot, Guards().timeless(), adapters=general)
    subgoals = build_subgoals(task.subgoals)
    loop = assemble(solver, subgoals, backend, dt=dt, filters=filters, policy=policy)
    loop.start(Start(spatial.IDENTITY[np.newaxis], joints, targets, _WARM_UP_SOLIDS), [rng])
    for _ in range(_WARM_UP_STEPS):
        loop.step()


def _check_reach(solver: IkSolver, goals: Array) -> None:
    options = solver.options
    options = replace(
        options, pose_tolerance=False,
        position_tolerance=max(options.position_tolerance, GOAL_METRES),
        rotation_tolerance=max(options.rotation_tolerance, GOAL_RADIANS),
    )  # fmt: skip
    placer = BasePlacer(solver.robot, options)
    reasons = [placer.place(goal, count=1).reason for goal in goals]
    if not any(reasons):
        return
    first = next(number for number, reason in enumerate(reasons) if reason)
    goal = "the goal" if len(goals) == 1 else f"the end of sub-goal {first + 1} of {len(goals)}"
    numbers = np.round([*goals[first, :3], *spatial.rpy(goals[first])], 3)
    x, y, z, roll, pitch, yaw = (f"{value + 0.0:g}" for value in numbers)
    raise KinfeasError(
        f"no base pose was found from which the arm reaches {goal}, x {x}, y {y}, z {z} m, roll "
        f"{roll}, pitch {pitch}, yaw {yaw} rad ({reasons[first]}); the setting "
        "guards.reach=false skips this check"
    )
