import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.control.drive import action_size, base_twist
from kinfeas.control.observation import HORIZON
from kinfeas.core.spatial import relative, wrap, yaw
from kinfeas.policies.baselines.geometric_modulation import GeometricModulation, modulated
from tests.policies.baselines.policy_inputs import policy_inputs, rows_of, turned_about

SHAPE = np.array([[-0.1, 0.05, 0.9, 1.0, 0.3, 0.4]])


@pytest.fixture
def policy(robot, ellipses):
    return GeometricModulation(robot, ellipses)


def levels(place, shape=SHAPE):
    inner = np.sum((place / shape[:, 4:6]) ** 2, axis=1)
    outer = np.sum(((place - shape[:, :2]) / shape[:, 2:4]) ** 2, axis=1)
    return inner, outer


def test_a_still_base_within_the_ring_stays():
    place = np.array([[0.6, 0.0], [0.0, -0.6], [-0.7, 0.2]])
    np.testing.assert_allclose(modulated(place, np.zeros((3, 2)), SHAPE.repeat(3, 0)), 0.0)


def test_never_leaves_the_ring():
    rng = np.random.default_rng(0)
    place = rng.uniform(-1.0, 1.0, (400, 2))
    inner, outer = levels(place)
    place = place[(inner > 1.05) & (outer < 0.95)]
    shape = SHAPE.repeat(len(place), 0)
    wanted = rng.uniform(-0.1, 0.1, (len(place), 2))
    for _ in range(400):
        place = place + modulated(place, wanted, shape) * 0.05
        inner, outer = levels(place)
        assert inner.min() > 0.95
        assert outer.max() < 1.05


@pytest.mark.parametrize("start", [[0.05, 0.1], [0.29, 0.0], [2.0, 1.0], [-1.2, 0.3]])
def test_comes_back_into_the_ring(start):
    place = np.array([start])
    for _ in range(2000):
        place = place + modulated(place, np.zeros((1, 2)), SHAPE) * 0.05
    inner, outer = levels(place)
    assert inner[0] > 0.97
    assert outer[0] < 1.03


def test_at_a_boundary_only_motion_along_it_is_left():
    on_inner = np.array([[0.3, 0.0]])
    velocity = modulated(on_inner, np.array([[-0.1, 0.02]]), SHAPE)
    assert abs(velocity[0, 0]) < 1e-6
    np.testing.assert_allclose(velocity[0, 1], 0.04, rtol=1e-3)


def test_leaving_a_boundary_is_left_as_it_is():
    velocity = np.array([[0.1, 0.02]])
    np.testing.assert_allclose(
        modulated(np.array([[0.31, 0.0]]), velocity, SHAPE), velocity, rtol=0.05
    )


def test_turns_the_ee_to_its_preferred_bearing(robot, policy):
    policy_input = policy_inputs(robot, 100, np.zeros(6))
    action = policy.act(policy_input)
    ee = relative(policy_input.ee_pose, policy_input.base_pose)
    off = wrap(np.arctan2(ee[:, 1], ee[:, 0]) - policy.ellipses.bearing)
    turn = action[:, -1]
    if robot.base.drive == "omnidirectional":
        np.testing.assert_array_equal(turn[np.abs(off) < 0.15], 0.0)
        assert np.all(np.sign(turn[np.abs(off) > 0.16]) == np.sign(off[np.abs(off) > 0.16]))
    else:
        far = np.abs(off) > 0.8
        assert np.mean(np.sign(turn[far]) == np.sign(off[far])) > 0.9


def test_stays_within_bounds(robot, policy):
    action = policy.act(policy_inputs(robot, 200, np.array([0.5, -0.8, 0.1, 0.3, 0.3, 1.0])))
    assert action.shape == (200, action_size(robot.base))
    assert np.abs(action).max() <= 1.0


def test_does_not_depend_on_the_map_or_on_the_batch(robot, policy):
    policy_input = policy_inputs(robot, 40)
    action = policy.act(policy_input)
    elsewhere = turned_about(policy_input, 2.0, (3.0, -1.0))
    np.testing.assert_allclose(policy.act(elsewhere), action, atol=1e-7)
    rows = [0, 17, 39]
    np.testing.assert_array_equal(policy.act(rows_of(policy_input, rows)), action[rows])


def test_survives_pickling(robot, policy):
    policy_input = policy_inputs(robot, 10)
    again = pickle.loads(pickle.dumps(policy))
    np.testing.assert_array_equal(again.act(policy_input), policy.act(policy_input))


def test_a_vertical_approach_is_no_trouble(robot, policy):
    policy_input = policy_inputs(robot, 3)
    down = Rotation.from_euler("ZYX", [[0.3, np.pi / 2.0, roll] for roll in (0.0, 1.0, 2.0)])
    down = down * Rotation.from_quat(robot.gripper_rotation)
    for poses in (policy_input.ee_pose, policy_input.planned):
        poses[:, 3:] = down.as_quat()
    twist = base_twist(robot.base, policy_input.base_pose, policy.act(policy_input), HORIZON)
    assert np.isfinite(twist).all()
    assert np.isfinite(yaw(policy_input.base_pose)).all()
