from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.drive import base_twist
from kinfeas.control.observation import HORIZON
from kinfeas.core.spatial import integrate, planar_pose, wrap, yaw
from kinfeas.policies.baselines.demonstrated_base import DemonstratedBase, demonstrated_base
from kinfeas.policies.baselines.follow_ee import FollowEe
from tests.policies.baselines.policy_inputs import policy_inputs, rows_of, turned_about


def seen(robot, count=20, seed=0):
    """Return situations whose demonstrated base lies up to a metre off and is turned."""
    policy_input = policy_inputs(robot, count, seed=seed)
    rng = np.random.default_rng(seed + 1)
    x, y = policy_input.base_pose[:, :2].T + rng.uniform(-0.7, 0.7, (2, count))
    heading = yaw(policy_input.base_pose) + rng.uniform(-1.0, 1.0, count)
    return replace(policy_input, demonstrated_base=planar_pose(x, y, heading))


def drive(policy, policy_input, steps):
    """Return base poses after some steps in which the EE keeps moving as it did."""
    for _ in range(steps):
        action = policy.act(policy_input)
        assert np.abs(action).max() <= 1.0
        twist = base_twist(policy.base, policy_input.base_pose, action, HORIZON)
        base = integrate(policy_input.base_pose, twist, HORIZON)
        policy_input = replace(policy_input, base_pose=base)
    return policy_input.base_pose


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_arrives_at_the_demonstrated_pose_shifted_forward(robot, shift):
    policy_input = seen(robot)
    wanted = policy_input.demonstrated_base
    heading = yaw(wanted)
    aim = wanted[:, :2] + shift * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    base = drive(DemonstratedBase(robot.base, shift), policy_input, 600)
    omni = robot.base.drive == "omnidirectional"
    assert np.linalg.norm(base[:, :2] - aim, axis=1).max() < (1e-6 if omni else 0.06)
    assert np.abs(wrap(yaw(base) - heading)).max() < 1e-3


def test_goes_at_the_pace_of_the_ee(robot):
    policy_input = seen(robot)
    base = drive(DemonstratedBase(robot.base), policy_input, 1)
    way = np.linalg.norm(base[:, :2] - policy_input.base_pose[:, :2], axis=1)
    ee = np.linalg.norm(policy_input.planned[:, :3] - policy_input.desired[:, :3], axis=1)
    assert np.all(way <= np.maximum(ee, 0.05 * HORIZON) + 1e-9)


def test_stays_where_it_should_be(robot):
    policy_input = policy_inputs(robot, 5)
    policy_input = replace(policy_input, demonstrated_base=policy_input.base_pose)
    action = DemonstratedBase(robot.base).act(policy_input)
    np.testing.assert_allclose(action, 0.0, atol=1e-9)


def test_follows_the_ee_where_there_is_no_demonstrated_base(robot):
    policy_input = seen(robot)
    policy_input.demonstrated_base[::2] = np.nan
    with np.errstate(all="raise"):
        action = DemonstratedBase(robot.base).act(policy_input)
    follow = FollowEe(robot.base).act(policy_input)
    np.testing.assert_array_equal(action[::2], follow[::2])
    assert np.all(np.any(action[1::2] != follow[1::2], axis=1))


def test_does_not_depend_on_the_map_or_on_the_batch(robot):
    policy, policy_input = demonstrated_base(robot), seen(robot)
    action = policy.act(policy_input)
    np.testing.assert_allclose(
        policy.act(turned_about(policy_input, 2.0, (3.0, -1.0))), action, atol=1e-9
    )
    rows = [3, 11]
    np.testing.assert_array_equal(policy.act(rows_of(policy_input, rows)), action[rows])


def test_the_shift_of_each_robot_is_read(robot):
    expected = {"pr2": 0.02, "tiago": 0.0, "hsr": 0.25}
    assert demonstrated_base(robot).forward_shift == expected[robot.name]
    assert demonstrated_base(replace(robot, name="mine")).forward_shift == 0.0
