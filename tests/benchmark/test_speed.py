import math
import os

import numpy as np
import pytest

from kinfeas.benchmark import peers, speed
from kinfeas.benchmark.peers import Peer, arm_urdf, pinocchio_peer, pybullet_peer
from kinfeas.benchmark.speed import (
    Effort,
    Figure,
    best_of,
    cold_targets,
    environment_rate,
    measure_speed,
    measure_training,
    one_core,
    peak_memory_mb,
    time_ours,
    time_peer,
    warm_targets,
)
from kinfeas.core import spatial
from kinfeas.envs.world import WorldConfig
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.robots.loading import load_robot
from kinfeas.training.run import Progress

KEYS = {
    "ik_warm_us", "ik_cold_us", "ik_cold_solved", "pinocchio_warm_us", "pinocchio_cold_us",
    "pybullet_warm_us", "env_steps_per_s_1", "env_steps_per_s_128", "env_steps_per_s_1024",
    "train_steps_per_s", "action_us", "peak_rss_mb",
}  # fmt: skip
SMALL = Effort(targets=20, repeats=1)


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


@pytest.fixture(scope="module")
def cold(pr2):
    return cold_targets(pr2, 100, np.random.default_rng(0))


@pytest.fixture(scope="module")
def warm(pr2):
    return warm_targets(pr2, 100, np.random.default_rng(1))


@pytest.mark.parametrize("installed", [True, False])
def test_all_figures(monkeypatch, installed):
    monkeypatch.setattr(speed, "BATCHES", {1: 3, 128: 2, 1024: 1})
    trained = Figure("training", 3000.0, "steps/s", "train_steps_per_s")
    monkeypatch.setattr(speed, "measure_training", lambda robot, effort: iter([trained]))
    if not installed:
        monkeypatch.setattr(peers, "find_spec", lambda name: None)
    parts = []
    figures = measure_speed("hsr", effort=SMALL, on_part=parts.append)
    assert {figure.key for figure in figures if figure.key} == KEYS
    assert all(figure.value is None or math.isfinite(figure.value) for figure in figures)
    assert len(parts) == 4
    missing = {figure.key for figure in figures if figure.value is None and figure.key}
    assert installed or missing == {"pinocchio_warm_us", "pinocchio_cold_us", "pybullet_warm_us"}


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


def test_ended_episodes_are_followed_by_others(monkeypatch, pr2):
    monkeypatch.setattr(speed, "WorldConfig", lambda: WorldConfig(max_seconds=0.4))
    assert environment_rate(pr2, FollowEe(pr2.base), batch=3, steps=20, repeats=1) > 0.0


def test_targets(pr2, cold, warm):
    solver = IkSolver(pr2)
    for targets in (cold, warm):
        assert targets.pose.shape == (100, 7)
        assert not self_collides(solver.collision, targets.seed).any()
    metres, radians = spatial.distance(forward(solver.chain, warm.seed), warm.pose)
    assert 0.0 < metres.min() <= metres.max() <= 0.03 + 1e-4
    assert np.abs(radians - 0.01).max() <= 1e-3
    again = warm_targets(pr2, 100, np.random.default_rng(1))
    np.testing.assert_array_equal(again.pose, warm.pose)


def test_warm_targets_within_a_pose_tolerance_differ_from_the_start():
    hsr = load_robot("hsr")
    targets = warm_targets(hsr, 50, np.random.default_rng(1))
    metres, _ = spatial.distance(forward(IkSolver(hsr).chain, targets.seed), targets.pose)
    assert 0.0 < metres.min() < np.median(metres) <= 0.03


def test_solved_targets_are_verified(pr2, cold, warm):
    for targets in (cold, warm):
        timing = time_ours(pr2, targets, self_collision=True, repeats=1)
        assert timing.solved >= 0.98
        assert timing.microseconds > 0.0
    lazy = Peer("lazy", lambda pose: pose, lambda target, seed: seed)
    beyond = Peer("beyond", lambda pose: pose, lambda target, seed: seed + 100.0)
    assert time_peer(pr2, lazy, warm, repeats=1).solved <= 0.05
    assert time_peer(pr2, beyond, warm, repeats=1).solved == 0.0


def test_pinocchio_solves_the_same_targets(pr2, cold, warm):
    pytest.importorskip("pinocchio")
    peer = pinocchio_peer(pr2)
    assert time_peer(pr2, peer, warm, repeats=1).solved >= 0.98
    assert time_peer(pr2, peer, cold, repeats=1).solved >= 0.95


def test_pybullet_answers_silently(pr2, warm, capfd):
    pytest.importorskip("pybullet")
    timing = time_peer(pr2, pybullet_peer(pr2), warm, repeats=1)
    assert timing.microseconds > 0.0
    assert 0.0 <= timing.solved <= 1.0
    assert capfd.readouterr() == ("", "")


def test_the_arm_of_the_peers_is_ours(robot, solver):
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromXML(arm_urdf(robot))
    data = model.createData()
    assert model.nq == len(robot.arm)
    for seed in cold_targets(robot, 20, np.random.default_rng(0)).seed:
        pin.framesForwardKinematics(model, data, seed)
        theirs = pin.SE3ToXYZQUAT(data.oMf[model.getFrameId(robot.ee_frame)])
        metres, radians = spatial.distance(forward(solver.chain, seed), theirs)
        assert metres < 1e-9
        assert radians < 1e-7


def test_the_fastest_run_counts_and_short_work_is_repeated(monkeypatch):
    now = iter([0.0, 5.0, 10.0, 11.0, 20.0, 23.0])
    monkeypatch.setattr(speed.time, "perf_counter", lambda: next(now))
    assert best_of(3, lambda: None, at_least=0.0) == 1.0
    ticks, runs = iter(range(100)), []
    monkeypatch.setattr(speed.time, "perf_counter", lambda: 0.01 * next(ticks))
    best_of(2, lambda: runs.append(1), at_least=0.1)
    assert len(runs) >= 9


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs Linux")
def test_one_core_is_given_back():
    before = os.sched_getaffinity(0)
    with pytest.raises(ZeroDivisionError), one_core():
        assert len(os.sched_getaffinity(0)) == 1
        raise ZeroDivisionError
    assert os.sched_getaffinity(0) == before


def test_peak_memory_grows():
    before = peak_memory_mb()
    held = b"x" * int((before + 100.0) * 1e6)
    assert before + 100.0 <= peak_memory_mb() < 100_000
    del held
