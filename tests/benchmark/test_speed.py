import math

import numpy as np
import pytest

from kinfeas.benchmark import speed
from kinfeas.benchmark.speed import (
    Effort,
    Figure,
    environment_rate,
    measure_speed,
    measure_training,
    random_network,
)
from kinfeas.control import drive, observation
from kinfeas.envs.world import WorldConfig
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.robots.loading import load_robot
from kinfeas.training.run import Progress

KEYS = {
    "ik_warm_us", "ik_cold_us", "ik_cold_solved", "pinocchio_warm_us", "pinocchio_cold_us",
    "pybullet_warm_us", "env_steps_per_s_1", "env_steps_per_s_128", "env_steps_per_s_1024",
    "train_steps_per_s", "action_us", "peak_rss_mb",
}  # fmt: skip

SMALL = Effort(targets=50, repeats=1)


@pytest.fixture
def quick(monkeypatch):
    """Time little, and no training."""
    monkeypatch.setattr(speed, "BATCHES", {1: 3, 128: 2, 1024: 1})
    trained = Figure("training", 3000.0, "steps/s", "train_steps_per_s")
    monkeypatch.setattr(speed, "measure_training", lambda robot, effort: iter([trained]))


def test_measures_what_is_asked_for(quick):
    parts = []
    figures = measure_speed("pr2", effort=SMALL, on_part=parts.append)
    keyed = [figure.key for figure in figures if figure.key]
    assert sorted(keyed) == sorted(KEYS)
    assert all(figure.value is None or math.isfinite(figure.value) for figure in figures)
    assert len(parts) == 4


def test_a_missing_peer_has_no_figure(quick, monkeypatch):
    monkeypatch.setattr("kinfeas.benchmark.peers.find_spec", lambda name: None)
    figures = {figure.key: figure.value for figure in measure_speed("pr2", effort=SMALL)}
    missing = {key for key, value in figures.items() if value is None and key}
    assert missing == {"pinocchio_warm_us", "pinocchio_cold_us", "pybullet_warm_us"}


def test_training_is_timed_by_the_robot_s_own_recipe(monkeypatch):
    configs = []

    def train(config, out):
        configs.append(config)
        return Progress(steps=600, seconds=2.0)

    monkeypatch.setattr("kinfeas.training.train.train", train)
    (figure,) = measure_training("tiago", SMALL)
    assert figure.value == 300.0
    (config,) = configs
    assert (config.num_envs, config.action_repeat, config.learner.gamma) == (64, 4, 0.995)
    assert (config.schedule.minutes, config.schedule.evaluations) == (SMALL.train_minutes, 1)


def test_ended_episodes_are_followed_by_others(monkeypatch):
    robot = load_robot("pr2")
    monkeypatch.setattr(speed, "WorldConfig", lambda: WorldConfig(max_seconds=0.4))
    assert environment_rate(robot, FollowEe(robot.base), batch=3, steps=20, repeats=1) > 0.0


def test_the_random_network_fits_the_robot(robot):
    network = random_network(robot)
    action = network(np.ones((5, observation.size(len(robot.arm)))))
    assert action.shape == (5, drive.action_size(robot.base))
    assert np.all(np.abs(action) <= 1.0)
