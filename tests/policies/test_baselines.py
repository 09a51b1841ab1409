from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.observation import HORIZON, ObservedState, observe
from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.policy import Observation
from kinfeas.core.spatial import compose, integrate, planar_pose, wrap, yaw
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.forward import build_chain, forward, jacobian
from kinfeas.kinematics.ik import spread_configurations
from kinfeas.policies.baselines import whole_body_qp as qp
from kinfeas.policies.baselines.following import FollowBase, FollowEe, demonstrated_base
from kinfeas.policies.baselines.geometric_modulation import (
    GeometricModulation,
    fit_ellipses,
    modulated,
)
from kinfeas.robots.loading import load_robot
from kinfeas.testing import check_policy

SHAPE = np.array([[-0.1, 0.05, 0.9, 1.0, 0.3, 0.4]])


def policy_inputs(robot, count, twist=None, base_pose=None):
    """Return observations whose EE is to move by `twist`, (6,), or at random."""
    rng, joints = np.random.default_rng(0), spread_configurations(robot, count)
    if base_pose is None:
        base_pose = planar_pose(*rng.uniform(-2.0, 2.0, (2, count)), rng.uniform(-3.0, 3.0, count))
    if twist is None:
        twist = rng.uniform(-0.1, 0.1, (count, 6))
    in_base = forward(build_chain(robot), joints)
    ee = compose(base_pose, in_base)
    planned = integrate(ee, np.broadcast_to(twist, (count, 6)), HORIZON)
    values = observe(ObservedState(base_pose, in_base, planned, planned, joints))
    none = np.full((count, 7), np.nan)
    return Observation(values, base_pose, ee, joints, ee, planned, none, none, HORIZON)


@pytest.fixture(params=["hsr", "tiago"])  # omnidirectional and differential
def robot(request):
    return load_robot(request.param)


def drive(policy, given, base):
    return base_twist(base, given.base_pose, policy.act(given), HORIZON)


def moving(robot, velocity, lag=(0.0, 0.0)):
    """Return inputs of a base with heading 0.7 whose EE moves at `velocity` and lags by `lag`."""
    base = planar_pose(np.ones(1), np.zeros(1), np.full(1, 0.7))
    given = policy_inputs(robot, 1, np.array([*velocity, 0.05, 0.0, 0.0, 0.0]), base_pose=base)
    ee = given.desired.copy()
    ee[:, :2] -= lag
    return replace(given, ee_pose=ee)


@pytest.mark.parametrize("feedback", [False, True])
def test_follow_ee_copies_the_planar_velocity_and_feedback_adds_the_error(robot, feedback):
    along = np.array([np.cos(0.7), np.sin(0.7)])
    policy = FollowEe(robot.base, feedback)
    twist = drive(policy, moving(robot, 0.08 * along), robot.base)
    np.testing.assert_allclose(twist[0], [*(0.08 * along), 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    twist = drive(policy, moving(robot, 0.0 * along, 0.005 * along), robot.base)
    error = 0.05 * along if feedback else np.zeros(2)
    np.testing.assert_allclose(twist[0], [*error, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


def demonstrated(robot, count=20):
    given, rng = policy_inputs(robot, count), np.random.default_rng(1)
    x, y = given.base_pose[:, :2].T + rng.uniform(-0.7, 0.7, (2, count))
    heading = yaw(given.base_pose) + rng.uniform(-1.0, 1.0, count)
    return replace(given, demonstrated_base=planar_pose(x, y, heading))


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_demonstrated_base_arrives_at_the_shifted_pose(robot, shift):
    policy, given = FollowBase(robot.base, shift), demonstrated(robot)
    wanted = given.demonstrated_base
    heading = yaw(wanted)
    aim = wanted[:, :2] + shift * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    for _ in range(600):
        twist = drive(policy, given, robot.base)
        given = replace(given, base_pose=integrate(given.base_pose, twist, HORIZON))
    omni = robot.base.drive == "omnidirectional"
    away = np.linalg.norm(given.base_pose[:, :2] - aim, axis=1)
    assert away.max() < (1e-6 if omni else 0.06)
    assert np.abs(wrap(yaw(given.base_pose) - heading)).max() < 1e-3


def test_demonstrated_base_follows_the_ee_without_a_demonstration(robot, tmp_path):
    given = demonstrated(robot)
    given.demonstrated_base[::2] = np.nan
    with np.errstate(all="raise"):
        action = FollowBase(robot.base).act(given)
    follow = FollowEe(robot.base).act(given)
    np.testing.assert_array_equal(action[::2], follow[::2])
    assert np.all(np.any(action[1::2] != follow[1::2], axis=1))
    assert demonstrated_base(load_robot("hsr")).forward_shift == 0.25
    assert demonstrated_base(replace(robot, folder=tmp_path)).forward_shift == 0.0


def test_modulation_keeps_the_contract_of_policies(robot):
    check_policy(GeometricModulation(robot, fit_ellipses(robot)), robot)


def levels(place):
    inner = np.sum((place / SHAPE[:, 4:6]) ** 2, axis=1)
    outer = np.sum(((place - SHAPE[:, :2]) / SHAPE[:, 2:4]) ** 2, axis=1)
    return inner, outer


def test_modulation_never_leaves_the_ring():
    rng = np.random.default_rng(0)
    place = rng.uniform(-1.0, 1.0, (400, 2))
    inner, outer = levels(place)
    place = place[(inner > 1.05) & (outer < 0.95)]
    shape, wanted = SHAPE.repeat(len(place), 0), rng.uniform(-0.1, 0.1, (len(place), 2))
    np.testing.assert_allclose(modulated(place, 0.0 * wanted, shape), 0.0)
    for _ in range(400):
        place = place + modulated(place, wanted, shape) * 0.05
        inner, outer = levels(place)
        assert inner.min() > 0.95
        assert outer.max() < 1.05


@pytest.mark.parametrize("name", ["hsr", "tiago", "stretch3"])  # stretch3 has a telescope
def test_the_model_of_the_qp_agrees_with_our_kinematics(name):
    pin, robot = pytest.importorskip("pinocchio"), load_robot(name)
    model, chain, carried = qp.build_model(robot), build_chain(robot), command_size(robot.base)
    data, frame, tree = model.createData(), model.getFrameId("ee"), chain.tree
    by_variable = np.eye(len(robot.arm))[tree.variable] * tree.multiplier[:, np.newaxis]
    for q in spread_configurations(robot, 20):
        full = np.concatenate([np.zeros(carried), by_variable @ q])
        found = pin.computeFrameJacobian(
            model, data, full, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        x, y, z = forward(chain, q)[:3]
        np.testing.assert_allclose(data.oMf[frame].translation, [x, y, z], atol=1e-9)
        np.testing.assert_allclose(found[:, carried:] @ by_variable, jacobian(chain, q), atol=1e-9)
        base = [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0]][: carried - 1]
        np.testing.assert_allclose(found[:, :carried].T, [*base, [-y, x, 0, 0, 0, 1]], atol=1e-9)


def test_the_qp_drives_a_robot_with_a_telescope_along_with_its_ee():
    pytest.importorskip("pink")
    robot = load_robot("stretch3")
    policy, along = qp.whole_body_qp(robot), 0.1 * np.array([np.cos(0.7), np.sin(0.7)])
    for direction in (-1.0, 1.0):
        action = policy.act(moving(robot, direction * along))[0]
        assert direction * action[0] * robot.base.max_velocity > 0.03


def test_barriers_keep_the_base_of_the_qp_off_obstacles(robot):
    pytest.importorskip("pink")
    pillar = np.array([[[0.4, 0.0]]]), np.array([[[1.0, 0.0]]])
    given = moving(robot, 0.15 * np.array([np.cos(0.7), np.sin(0.7)]))
    free = qp.whole_body_qp(robot).act(given)
    assert free[0, 0] * robot.base.max_velocity > 0.05
    for distance, limit in ((0.031, 0.005), (0.02, -0.02)):

        class Beside:
            def obstacle_distances(self, within, distance=distance):
                closing = np.zeros((1, 1))
                return ObstacleDistances(*pillar, np.full((1, 1), distance), closing)

        action = qp.whole_body_qp(robot).act(replace(given, obstacles=Beside()))
        assert action[0, 0] * robot.base.max_velocity == pytest.approx(limit, abs=1e-4)
