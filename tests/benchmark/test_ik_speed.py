import subprocess
import sys

import numpy as np
import pytest

from kinfeas.benchmark.ik_speed import cold_targets, time_ours, time_peer, warm_targets
from kinfeas.benchmark.peers import Peer, arm_urdf, pinocchio_peer, pybullet_peer
from kinfeas.core import spatial
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.self_collision import self_collides


@pytest.fixture(scope="module")
def cold(robot):
    return cold_targets(robot, 100, np.random.default_rng(0))


@pytest.fixture(scope="module")
def warm(robot):
    return warm_targets(robot, 100, np.random.default_rng(1))


def test_seeds_are_free_of_self_collision(solver, cold, warm):
    for targets in (cold, warm):
        assert targets.pose.shape == (100, 7)
        assert targets.seed.shape == (100, len(solver.robot.arm))
        assert not self_collides(solver.collision, targets.seed).any()


def test_warm_targets_are_one_step_away(solver, warm):
    metres, radians = spatial.distance(forward(solver.chain, warm.seed), warm.pose)
    if solver.robot.pose_tolerance is None:
        assert metres.max() <= 0.03 + 1e-4
        assert np.abs(radians - 0.01).max() <= 1e-3
    else:
        assert np.median(metres) <= 0.03
    assert metres.min() > 0.0


def test_the_same_rng_gives_the_same_targets(robot, warm):
    again = warm_targets(robot, 100, np.random.default_rng(1))
    np.testing.assert_array_equal(again.pose, warm.pose)
    np.testing.assert_array_equal(again.seed, warm.seed)


def test_ours_solves_both_kinds(robot, cold, warm):
    for targets in (cold, warm):
        timing = time_ours(robot, targets, self_collision=True, repeats=1)
        assert timing.solved >= 0.98
        assert timing.microseconds > 0.0


def test_a_wrong_answer_is_not_counted(robot, warm):
    lazy = Peer("lazy", lambda pose: pose, lambda target, seed: seed)
    beyond = Peer("beyond", lambda pose: pose, lambda target, seed: seed + 100.0)
    assert time_peer(robot, lazy, warm, repeats=1).solved <= 0.05
    assert time_peer(robot, beyond, warm, repeats=1).solved == 0.0


def test_pinocchio_solves_what_we_solve(robot, cold, warm):
    pytest.importorskip("pinocchio")
    peer = pinocchio_peer(robot)
    assert time_peer(robot, peer, warm, repeats=1).solved >= 0.98
    assert time_peer(robot, peer, cold, repeats=1).solved >= 0.95


def test_pybullet_answers(robot, warm):
    pytest.importorskip("pybullet")
    timing = time_peer(robot, pybullet_peer(robot), warm, repeats=1)
    assert timing.microseconds > 0.0
    assert 0.0 <= timing.solved <= 1.0


def test_the_arm_that_others_load_is_ours(robot, solver, cold):
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromXML(arm_urdf(robot))
    data = model.createData()
    assert model.nq == len(robot.arm)
    for seed in cold.seed[:20]:
        pin.framesForwardKinematics(model, data, seed)
        theirs = pin.SE3ToXYZQUAT(data.oMf[model.getFrameId(robot.ee_frame)])
        metres, radians = spatial.distance(forward(solver.chain, seed), theirs)
        assert metres < 1e-9
        assert radians < 1e-7


def test_pybullet_says_nothing_of_itself():
    code = """
from kinfeas.benchmark.peers import pybullet_peer
from kinfeas.robots.loading import load_robot
assert pybullet_peer(load_robot("pr2"))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.parametrize("make", [pinocchio_peer, pybullet_peer])
def test_a_peer_that_is_not_installed_is_none(robot, monkeypatch, make):
    monkeypatch.setattr("kinfeas.benchmark.peers.find_spec", lambda name: None)
    assert make(robot) is None
