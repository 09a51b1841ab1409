"""Evaluations by the names of policy, robot and task, in either world."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

from kinfeas import config
from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core.metrics import Share
from kinfeas.core.policy import Policy
from kinfeas.core.registry import build
from kinfeas.envs.physics import physics_config
from kinfeas.evaluation import evaluate as analytic
from kinfeas.evaluation.evaluate import EvaluationConfig, Summary, Trial
from kinfeas.evaluation.physics.evaluate import evaluate_physics
from kinfeas.evaluation.physics.world import PhysicsTrial
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task

WorldName = Literal["analytic", "pybullet"]

EPISODES: dict[str, int] = {"analytic": 500, "pybullet": 50}
"""How many episodes an evaluation has by default, by world."""

Specs = tuple[PluginSpec, ...]


def make_trial(
    names: tuple[str, str, str], world: str, episodes: int, seed: int, overrides: Sequence[str]
) -> tuple[Trial | PhysicsTrial, Policy]:
    """Return the episodes of an evaluation, and the policy.

    Args:
        names: Of policy, robot and task.
        world: `analytic` or `pybullet`.
        episodes: How many.
        seed: Of all episodes.
        overrides: Settings as assignments `KEY=VALUE`.

    Raises:
        KinfeasError: If there is no such policy, robot or task, or a setting is wrong.
    """
    policy, robot_name, task_name = names
    robot = load_robot(robot_name)
    if world == "pybullet":
        physics = physics_config(robot, overrides)
        check_adapters(physics.world.adapters, robot)
        task = load_task(task_name, physics.task)
        driver = load_policy(policy, robot)
        return PhysicsTrial(robot, task, episodes, seed, physics.world), driver
    settings = config.from_mapping(EvaluationConfig, {}, "settings", overrides)
    check_adapters(settings.world.adapters, robot)
    task = load_task(task_name, settings.task)
    driver = load_policy(policy, robot)
    return Trial(robot, task, episodes, seed, settings.world), driver


def check_adapters(adapters: Specs, robot: Robot) -> None:
    """Check that adapters can be built, before all that takes long.

    Raises:
        KinfeasError: If one cannot.
    """
    wrap(build("kinfeas.backends", "analytic", {}), adapters, robot)


def ceiling_of(
    trial: Trial | PhysicsTrial, on_done: Callable[[float], None] | None = None
) -> Share:
    """Return the share of a trial's goals that some base pose reaches, in either world."""
    if isinstance(trial, PhysicsTrial):
        world = trial.settings.world
        trial = Trial(trial.robot, trial.task, trial.episodes, trial.seed, world)
    return analytic.trial_reachability(trial, on_done)


def within(trial: Trial | PhysicsTrial, adapters: Specs) -> Trial | PhysicsTrial:
    """Return a trial with adapters around its own."""
    if isinstance(trial, PhysicsTrial):
        chain = (*trial.settings.adapters, *adapters)
        return replace(trial, settings=replace(trial.settings, adapters=chain))
    return replace(trial, world=replace(trial.world, adapters=(*trial.world.adapters, *adapters)))


def run_evaluation(  # noqa: PLR0913 - as the functions that it calls
    trial: Trial | PhysicsTrial,
    policy: Policy,
    name: str,
    ceiling: Share | None = None,
    processes: int = 1,
    on_done: Callable[[int], None] | None = None,
    *,
    gui: bool = False,
) -> Summary:
    """Return the figures of a policy in either world; arguments as in `evaluate`."""
    if isinstance(trial, PhysicsTrial):
        return evaluate_physics(trial, policy, name, ceiling, processes, on_done, gui=gui)
    return analytic.evaluate(trial, policy, name, ceiling, processes, on_done)
