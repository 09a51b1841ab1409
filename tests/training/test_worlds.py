"""No training meets the episodes that its policy is judged on."""

from dataclasses import replace

import numpy as np
import pytest

from kinfeas import config
from kinfeas.benchmark.speed import random_network
from kinfeas.envs.physics import PhysicsChanges
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import evaluation_world
from kinfeas.kinematics.ik import IkOptions
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.training import worlds
from kinfeas.training.config import LAST_SEED, TrainConfig
from kinfeas.training.worlds import EVALUATION_SEED, FRESH_SEED, analytic_world, physics_world

EPISODES = 4


def goal(world, episode):
    """Return where an episode leads, shape (7,)."""
    world.start([episode])
    return world.loop.sequence.goal[0].copy()


def judged(settings, seed):
    """Return the goals of the first episodes of an evaluation, shape (4, 7)."""
    robot, task = load_robot(settings.robot), load_task(settings.task)
    world = World(robot, task, evaluation_world(), seed)
    return np.stack([goal(world, episode) for episode in range(EPISODES)])


def apart(one, other):
    """Return whether no goal of `one` is among those of `other`."""
    return not np.isclose(one[:, np.newaxis], other).all(axis=-1).any()


@pytest.mark.parametrize("seed", [0, 1, LAST_SEED])
def test_a_training_meets_none_of_the_episodes_of_its_seeds_evaluation(tiny, seed):
    settings = tiny(f"seed={seed}")
    learned, again = (
        np.stack([goal(analytic_world(settings), episode) for episode in range(EPISODES)])
        for _ in range(2)
    )
    np.testing.assert_array_equal(learned, again)
    assert apart(learned, judged(settings, seed))
    chosen, fresh = (judged(settings, seed + offset) for offset in (EVALUATION_SEED, FRESH_SEED))
    assert apart(learned, chosen)
    assert apart(learned, fresh)
    assert apart(chosen, fresh)


def test_nor_does_one_with_physics():
    pytest.importorskip("pybullet")
    settings = config.from_mapping(TrainConfig, {"robot": "hsr", "physics": {}}, "physical")
    world = physics_world(settings)
    learned = np.stack([goal(world, episode) for episode in range(EPISODES)])
    world.loop.backend.close()
    assert apart(learned, judged(settings, settings.seed))


IK = {"restarts": 2, "pose_tolerance": False, "self_collision": False, "position_tolerance": 1e-3}


def test_evaluations_have_the_run_s_ik_with_more_restarts_and_its_filters(monkeypatch, tiny):
    analytic, physical = [], []
    monkeypatch.setattr(worlds, "run_episodes", lambda world, *_: analytic.append(world.config))
    monkeypatch.setattr(worlds, "run_physics", lambda trial, *_: physical.append(trial.settings))
    settings = tiny(f"world.ik={IK}", "world.filters=[{name: feasibility}]")
    network = random_network(load_robot(settings.robot))
    worlds.analytic_judge(settings, network)(network, 1)
    worlds.physics_judge(replace(settings, physics=PhysicsChanges()))(network, 1)
    for judged in (*analytic, *physical):
        assert judged.ik == IkOptions(**{**IK, "restarts": 24})
        assert judged.filters == settings.world.filters
