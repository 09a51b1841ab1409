import math

import numpy as np
import pytest

from kinfeas.benchmark import peers, speed
from kinfeas.benchmark.peers import Peer, arm_urdf
from kinfeas.benchmark.speed import (
    Effort,
    Figure,
    cold_targets,
    measure_ik,
    measure_speed,
    time_ours,
    time_peer,
    warm_targets,
)
from kinfeas.core import spatial
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.self_collision import self_collides
from tests.builders import assert_near

KEYS = {
    "ik_warm_us", "ik_cold_us", "ik_cold_solved", "pinocchio_warm_us", "pinocchio_cold_us",
    "pybullet_warm_us", "env_steps_per_s_1", "env_steps_per_s_128", "env_steps_per_s_1024",
    "room_steps_per_s",
    "train_steps_per_s", "action_us", "peak_rss_mb",
}  # fmt: skip
SMALL = Effort(targets=20, repeats=1)


@pytest.fixture(scope="module")
def cold(pr2):
    return cold_targets(pr2, 100, np.random.default_rng(0))


@pytest.fixture(scope="module")
def warm(pr2):
    return warm_targets(pr2, 100, np.random.default_rng(1))


def test_all_figures(monkeypatch):
    monkeypatch.setattr(speed, "BATCHES", {1: 3, 128: 2, 1024: 1})
    monkeypatch.setattr(speed, "ROOM_STEPS", 2)
    trained = Figure("training", 3000.0, "steps/s", "train_steps_per_s")
    monkeypatch.setattr(speed, "measure_training", lambda robot, effort: iter([trained]))
    parts = []
    figures = measure_speed("hsr", effort=SMALL, on_part=parts.append)
    assert {figure.key for figure in figures if figure.key} == KEYS
    assert all(figure.value is None or math.isfinite(figure.value) for figure in figures)
    assert len(parts) == 5


def test_peers_that_are_not_installed_have_no_figures(monkeypatch, hsr):
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    figures = measure_ik(hsr, SMALL)
    missing = {figure.key for figure in figures if figure.value is None and figure.key}
    assert missing == {"pinocchio_warm_us", "pinocchio_cold_us", "pybullet_warm_us"}


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


def test_solved_targets_are_verified(pr2, cold, warm):
    for targets in (cold, warm):
        timing = time_ours(pr2, targets, self_collision=True, repeats=1)
        assert timing.solved >= 0.98
        assert timing.microseconds > 0.0
    lazy = Peer("lazy", lambda pose: pose, lambda target, seed: seed)
    beyond = Peer("beyond", lambda pose: pose, lambda target, seed: seed + 100.0)
    assert time_peer(pr2, lazy, warm, repeats=1).solved <= 0.05
    assert time_peer(pr2, beyond, warm, repeats=1).solved == 0.0


def test_the_arm_of_the_peers_is_ours(robot, solver):
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromXML(arm_urdf(robot))
    data = model.createData()
    assert model.nq == len(robot.arm)
    for seed in cold_targets(robot, 20, np.random.default_rng(0)).seed:
        pin.framesForwardKinematics(model, data, seed)
        theirs = pin.SE3ToXYZQUAT(data.oMf[model.getFrameId(robot.ee_frame)])
        assert_near(forward(solver.chain, seed), theirs, 1e-9, 1e-7)
