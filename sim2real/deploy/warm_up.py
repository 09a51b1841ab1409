"""A short run in the analytic world, so that nothing is compiled once a robot moves."""

from collections.abc import Sequence

import numpy as np

from kinfeas.config import PluginSpec
from kinfeas.control.loop import Loop
from kinfeas.core import registry, spatial
from kinfeas.core.policy import CommandFilter, Policy
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.tasks.task import Task, build_subgoals

_STEPS = 5
_AWAY = np.array(
    [0.5, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]
)  # m, from the EE to what the sub-goals lead to


def warm_up(
    solver: IkSolver,
    policy: Policy,
    task: Task,
    dt: float,
    adapters: Sequence[PluginSpec] = (),
    filters: Sequence[CommandFilter] = (),
) -> None:
    """Let all parts of a run compute something once, but for the robot."""
    robot, rng = solver.robot, np.random.default_rng(0)
    joints = robot.home["home"][np.newaxis]
    target = forward(solver.chain, joints) + _AWAY
    start = Start(
        spatial.IDENTITY[np.newaxis], joints, np.stack([target] * len(task.subgoals), axis=1)
    )
    analytic = registry.build("kinfeas.backends", "analytic", {})
    backend = Guarded(analytic, robot, Guards().timeless(), adapters=adapters)
    loop = Loop(solver, build_subgoals(task.subgoals), backend, dt, filters=filters)
    loop.set_policy(policy)
    loop.start(start, [rng])
    for _ in range(_STEPS):
        loop.step(policy.act(loop.policy_input))
