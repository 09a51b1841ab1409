"""Worlds of a training run: for learning, and for the evaluation of its policies; without torch."""

import math
import signal
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from operator import methodcaller
from typing import Any

from kinfeas.core.metrics import EpisodeRecords
from kinfeas.envs.batch import Batch
from kinfeas.envs.episodes import OnDone, begin_worker, evaluate_episodes, evaluate_within
from kinfeas.envs.world import World, WorldConfig, evaluation_world
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig

EVALUATION_SEED = 1_000_003
"""Offset from the seed of training to that of the episodes that select the best checkpoint."""

FRESH_SEED = 2_000_003
"""Offset to the seed of the final episodes, which had no part in the selection."""

TRAINING = (1,)
"""Stream of training episodes; evaluations of any seed use other episodes."""

PeriodicEvaluator = Callable[..., EpisodeRecords]
"""Returns the records of a number of episodes, always the same ones; see `periodic_evaluator`."""


def training_world(config: TrainConfig) -> World:
    """Return the world that a run learns in."""
    task = load_task(config.task, config.task_parameters)
    world = World(load_robot(config.robot), task, config.world, config.seed)
    world.stream = TRAINING
    world.loop.observer.terms = config.observation
    return world


def part_of(config: TrainConfig, *, analytic: bool) -> TrainConfig:
    """Return the settings of a part of a run: in the analytic world, or in the world of the run.

    The analytic part has the control period of that world, and actions of the same duration. Its
    failures and gradient steps are as many in a second.
    """
    if not analytic:
        return config
    ratio = WorldConfig.dt / config.world.dt

    def fewer(count: int) -> int:
        return max(round(count / ratio), 1)

    world = replace(
        config.world,
        backend="analytic",
        backend_parameters={},
        dt=WorldConfig.dt,
        time_scale=WorldConfig.time_scale,  # its robots have no inertia
        arm_settle_timeout=WorldConfig.arm_settle_timeout,
        max_failures=fewer(config.world.max_failures),
    )
    learner = replace(config.learner, gradient_steps=fewer(config.learner.gradient_steps))
    repeat = fewer(config.action_repeat)
    return replace(config, world=world, processes=1, action_repeat=repeat, learner=learner)


def periodic_evaluator(config: TrainConfig, offset: int = EVALUATION_SEED) -> PeriodicEvaluator:
    """Return the evaluation of policies in the world of a run, with its `evaluation_adapters`.

    IK searches at least as hard as by default, and episodes end as in `evaluation_world`. Their
    seed is that of training plus `offset`. The evaluation takes the policy, the number of episodes,
    a function for those that have ended, and a time limit with the pool for it.
    """
    failures, ik = evaluation_world(config.world.backend).max_failures, config.world.ik.thorough()
    adapters = config.evaluation_adapters
    world = replace(config.world, max_failures=failures, adapters=adapters, ik=ik)
    robot, task = load_robot(config.robot), load_task(config.task, config.task_parameters)

    def evaluated(
        network: Network,
        episodes: int,
        on_done: OnDone | None = None,
        seconds: float = math.inf,
        pool: Executor | None = None,
    ) -> EpisodeRecords:
        build = partial(World, robot, task, world, config.seed + offset)
        if pool is None:
            return evaluate_episodes(build, network, range(episodes), config.processes, on_done)
        limits = seconds, pool, config.processes
        return evaluate_within(*limits, build, network, range(episodes), on_done)

    return evaluated


_worker: tuple[TrainConfig, int, int] | Batch  # of a worker process


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
