"""The worlds of a training run: where it learns, and where its policy is judged."""

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from kinfeas.core.metrics import EpisodeRecords
from kinfeas.envs.physics import PhysicsChanges, PhysicsSettings, make_physics_world, make_stage
from kinfeas.envs.world import World
from kinfeas.evaluation.episodes import run_episodes
from kinfeas.evaluation.physics.evaluate import run_physics
from kinfeas.evaluation.physics.world import PhysicsTrial
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training.config import TrainConfig

EVALUATION_SEED = 1_000_003
"""Offset between the seed of training and that of the episodes that pick the best checkpoint."""

FRESH_SEED = 2_000_003
"""The same for those that it is judged on in the end: they had no part in the choice."""

TRAINING = (1,)
"""Stream of the episodes that are learned from: of no seed are they those that policies are judged
on."""

MAX_FAILURES = 99
"""Of an episode that judges a policy."""

PeriodicEvaluator = Callable[[Network, int], EpisodeRecords]
"""Returns what happens in that many episodes, always the same ones."""


def analytic_world(config: TrainConfig) -> World:
    """Return the analytic world that a run learns in."""
    task = load_task(config.task, config.task_parameters)
    world = World(load_robot(config.robot), task, config.world, config.seed)
    world.stream = TRAINING
    return world


def physics_world(config: TrainConfig) -> World:
    """Return a PyBullet world that a run learns in.

    Raises:
        KinfeasError: If PyBullet is not installed, or the task's scene is broken.
    """
    assert config.physics is not None
    robot, task = load_robot(config.robot), load_task(config.task, config.task_parameters)
    stage = make_stage(robot, task, config.physics)
    world = make_physics_world(robot, stage, config.world, config.physics.execution, config.seed)
    world.stream = TRAINING
    return world


def analytic_judge(
    config: TrainConfig, network: Network, offset: int = EVALUATION_SEED
) -> PeriodicEvaluator:
    """Return what judges policies in the analytic world, which is exact and patient.

    IK searches as hard there as by default, for what the run counts as a solution.

    Args:
        config: Of the run.
        network: Any policy: kernels are compiled here, so that it is not counted as training time.
        offset: Between the seed of training and that of the episodes.
    """
    task = load_task(config.task, config.task_parameters)
    ik = config.world.ik.thorough()
    judged = replace(config.world, max_failures=MAX_FAILURES, adapters=(), ik=ik)
    robot = load_robot(config.robot)
    world = World(robot, task, judged, config.seed + offset)
    world.start([0])
    network.act(world.loop.policy_input)
    world.step(np.zeros((1, world.action_size)))
    return lambda policy, episodes: run_episodes(world, policy, episodes)


def physics_judge(config: TrainConfig, offset: int = EVALUATION_SEED) -> PeriodicEvaluator:
    """Return what judges policies in the PyBullet world, in as many processes as learn.

    IK searches as in `analytic_judge`.
    """
    physics, world = config.physics, config.world
    assert physics is not None
    changes = {one.name: getattr(physics, one.name) for one in fields(PhysicsChanges)}
    settings = PhysicsSettings(
        **changes,
        filters=world.filters,
        dt=world.dt,
        max_failures=MAX_FAILURES,
        max_seconds=world.max_seconds,
        ik=world.ik.thorough(),
    )
    robot, task = load_robot(config.robot), load_task(config.task, config.task_parameters)
    trial = PhysicsTrial(robot, task, 1, config.seed + offset, settings)

    def judge(network: Network, episodes: int) -> EpisodeRecords:
        return run_physics(replace(trial, episodes=episodes), network, config.processes)

    return judge
