"""No training meets the episodes that its policy is judged on."""

import numpy as np
import pytest

from kinfeas import config, registry
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import evaluation_world
from kinfeas.tasks.loading import load_task
from kinfeas.training import worlds
from kinfeas.training.config import LAST_SEED, TrainConfig
from kinfeas.training.worlds import EVALUATION_SEED, analytic_world, physics_world

EPISODES = 4


def goal(world, episode):
    """Return where an episode leads, shape (7,)."""
    world.start([episode])
    return world.loop.course.goal[0].copy()


def judged(settings, seed):
    """Return the goals of the first episodes of an evaluation, shape (4, 7)."""
    robot, task = registry.load_robot(settings.robot), load_task(settings.task)
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
    assert apart(learned, judged(settings, seed + EVALUATION_SEED))


def test_nor_does_one_with_physics():
    pytest.importorskip("pybullet")
    settings = config.from_mapping(TrainConfig, {"robot": "hsr", "physics": {}}, "physical")
    world = physics_world(settings)
    learned = np.stack([goal(world, episode) for episode in range(EPISODES)])
    world.loop.backend.close()
    assert apart(learned, judged(settings, settings.seed))


def test_evaluations_stay_what_they_have_always_been(robot):
    task = load_task("ggr")
    world = World(robot, task, evaluation_world(), seed=1)
    for episode in range(EPISODES):
        start = task.sample(world.solver, np.random.default_rng((1, episode)))
        np.testing.assert_array_equal(goal(world, episode), start.target_poses[0])


@pytest.mark.parametrize("asks", ["physics", "world"])
def test_a_training_with_physics_is_judged_yielding_if_it_learns_so(monkeypatch, asks):
    trials = []
    monkeypatch.setattr(worlds, "run_physics", lambda trial, *_: trials.append(trial))
    told = {"robot": "hsr", "physics": {}, asks: {"yields": True}}
    worlds.physics_judge(config.from_mapping(TrainConfig, told, "physical"))(None, 3)
    assert trials[0].settings.pace.yields
