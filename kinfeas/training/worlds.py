"""Worlds of a training run: for learning, and for the evaluation of its policies; without torch."""

import math
import signal
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from operator import methodcaller
from typing import Any

from kinfeas.config import PluginSpec, registry
from kinfeas.control.assemble import respond_late
from kinfeas.core.metrics import EpisodeRecords
from kinfeas.envs.episodes import OnDone, begin_worker, evaluate_episodes, evaluate_within
from kinfeas.envs.world import Batch, World, WorldConfig, evaluation_world
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig

EVALUATION_SEED = 1_000_003
"""Offset from the seed of training to that of the episodes that select the best checkpoint."""

FRESH_SEED = 2_000_003
"""Offset to the seed of the final episodes, which had no part in the selection."""

TRAINING = (1,)
"""Random stream of training episodes; evaluations of any seed have other episodes."""

_WAITING = "time_scaling"  # filter by which the EE waits for the robot


def training_world(config: TrainConfig) -> World:
    """Return the world that a run learns in."""
    task = load_task(config.task, config.task_parameters)
    world = World(load_robot(config.robot), task, config.world, config.seed)
    world.stream = TRAINING
    world.loop.observer.terms = config.observation
    return world


def part_of(config: TrainConfig, *, analytic: bool) -> TrainConfig:
    """Return the settings of a part of a run: the first, `analytic` one, or that in its own world.

    In the first part robots respond at once: their response model is the default one, and adapters
    that make them late or need a physics engine are left out. Its control period is the default of
    the analytic world. The duration of actions, and the failures and gradient steps per second, are
    those of the run's own world. There, the EE waits for robots that respond late.
    """
    names = [spec.name for spec in config.world.filters]
    if not analytic:
        if not config.world.late or _WAITING in names:
            return config
        waiting = (*config.world.filters, PluginSpec(_WAITING))
        return replace(config, world=replace(config.world, filters=waiting))
    ratio = WorldConfig.dt / config.world.dt

    def rescaled(count: int) -> int:
        return max(round(count / ratio), 1)

    world = replace(
        config.world,
        adapters=tuple(spec for spec in config.world.adapters if not _needs_own_world(spec)),
        backend="analytic",
        backend_parameters={},
        dt=WorldConfig.dt,
        response=WorldConfig.response,
        time_scale=WorldConfig.time_scale,  # its robots have no inertia
        arm_settle_timeout=WorldConfig.arm_settle_timeout,
        max_failures=rescaled(config.world.max_failures),
    )
    learner = replace(config.learner, gradient_steps=rescaled(config.learner.gradient_steps))
    repeat = rescaled(config.action_repeat)
    return replace(config, world=world, processes=1, action_repeat=repeat, learner=learner)


def in_evaluation(config: TrainConfig) -> TrainConfig:
    """Return the settings of a run's evaluations, with `evaluation_adapters`."""
    world = replace(config.world, adapters=config.evaluation_adapters)
    return part_of(replace(config, world=world), analytic=False)


def has_first_part(config: TrainConfig) -> bool:
    """Return whether a run begins in the analytic world, with robots that respond at once."""
    adapters = config.world.adapters
    other = config.world.backend != "analytic" or any(_needs_own_world(spec) for spec in adapters)
    return other and config.init is None and config.schedule.analytic > 0.0


def _needs_own_world(adapter: PluginSpec) -> bool:
    needs = getattr(registry.load("kinfeas.adapters", adapter.name), "needs", "")
    return bool(needs) or respond_late([adapter])


def evaluate_network(  # noqa: PLR0913, PLR0917 - an evaluation and how to run it
    config: TrainConfig,
    network: Network,
    episodes: int,
    offset: int = EVALUATION_SEED,
    on_done: OnDone | None = None,
    seconds: float = math.inf,
    pool: Executor | None = None,
) -> EpisodeRecords:
    """Return the records of a policy in the world of a run, with its `evaluation_adapters`.

    IK searches at least as hard as by default, and episodes end as in `evaluation_world`. Their
    seed is that of training plus `offset`. `seconds` limit an evaluation in a `pool`; the other
    arguments are those of `evaluate_episodes`.
    """
    config = in_evaluation(config)
    failures, ik = evaluation_world(config.world.backend).max_failures, config.world.ik.thorough()
    world = replace(config.world, max_failures=failures, ik=ik)
    robot, task = load_robot(config.robot), load_task(config.task, config.task_parameters)
    build = partial(World, robot, task, world, config.seed + offset)
    if pool is None:
        return evaluate_episodes(build, network, range(episodes), config.processes, on_done)
    limits = seconds, pool, config.processes
    return evaluate_within(*limits, build, network, range(episodes), on_done)


_worker: tuple[TrainConfig, int, int] | Batch  # batch of this process; before, its arguments


def begin_batch(config: TrainConfig, rows: int, first: int) -> None:
    """Prepare a worker process for a batch of `rows` episodes with physics, from `first` on."""
    global _worker
    begin_worker(signal.SIG_IGN)  # its parent handles Ctrl-C
    _worker = config, rows, first


def call_batch(method: str, *arguments: Any) -> Any:
    """Return the result of a method of this worker's batch, which the first call builds."""
    global _worker
    if not isinstance(_worker, Batch):
        config, rows, first = _worker
        _worker = Batch(training_world(config), rows, config.action_repeat)
        _worker.world.next_episode = first
    return methodcaller(method, *arguments)(_worker)
