from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.drives import cubic
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from tests.backends.pybullet.conftest import twist

NUMBER = st.floats(-2.0, 2.0)


@given(NUMBER, NUMBER, NUMBER, st.floats(0.05, 2.0))
def test_a_cubic_begins_as_it_should_and_ends_at_rest(position, velocity, change, duration):
    time = np.array([0.0, 1e-7, duration, 2.0 * duration])
    at = [np.array([value]) for value in (position, velocity, change)]
    way, speed = cubic(*at, duration, time)
    assert way[0, 0] == position
    assert speed[0, 0] == velocity
    assert (way[1, 0] - way[0, 0]) / 1e-7 == pytest.approx(velocity, abs=1e-2)
    np.testing.assert_allclose(way[2:, 0], position + change, atol=1e-9)
    np.testing.assert_allclose(speed[2:, 0], 0.0, atol=1e-9)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_cubic_stays_below_the_speed_it_was_made_for(start, share):
    change, duration = np.array([share]), 1.5 * max(share, 0.1)
    _, speed = cubic(np.zeros(1), np.array([start]), change, duration, np.linspace(0, 2, 99))
    assert np.abs(speed).max() <= 1.0 + 1e-9


def test_a_target_is_reached_in_a_tenth_of_a_second(world, begin):
    robot = world.sims[0].body.robot
    target = robot.home["home"] + 0.005 * robot.max_joint_velocity
    begin()
    state = world.step(twist(), target[np.newaxis], 0.1)
    np.testing.assert_allclose(state.joint_positions[0], target, atol=1e-3)


def test_joints_keep_their_speed_limits(world, begin):
    robot = world.sims[0].body.robot
    rng = np.random.default_rng(0)
    lower = np.array([max(joint.lower, -1.5) for joint in robot.arm])
    upper = np.array([min(joint.upper, 1.5) for joint in robot.arm])
    begin(x=1.0)
    for _ in range(6):
        target = rng.uniform(lower, upper)[np.newaxis]
        for _ in range(12):
            speed = world.step(twist(), target, 0.02).joint_velocities[0]
            assert np.all(np.abs(speed) <= robot.max_joint_velocity * 1.05)


def test_no_joint_runs_ahead_of_the_slowest(world, begin):
    """All are at any moment the same share of the way to a target far away, but for their lag."""
    robot = world.sims[0].body.robot
    home = robot.home["home"]
    # A second's way of the first joint, a tenth of that of each other one.
    away = np.where(np.arange(len(home)) == 0, 1.0, 0.1) * robot.max_joint_velocity
    lower, upper = robot.joint_limits
    away = np.where(home + away > upper, -away, away)
    assert np.all((home + away >= lower) & (home + away <= upper))
    begin()
    for _ in range(20):
        state = world.step(twist(), (home + away)[np.newaxis], 0.02)
        share = (state.joint_positions[0] - home) / away
        np.testing.assert_allclose(share, share[0], atol=0.08)
    assert 0.2 < share[0] < 0.5


def test_no_joint_is_faster_than_its_limit(world, begin):
    robot = world.sims[0].body.robot
    begin()
    lower, upper = robot.finite_joint_limits
    far = np.clip(robot.home["home"] + 1.5, lower, upper)
    fastest = np.zeros(len(robot.arm))
    for _ in range(100):
        state = world.step(twist(), far[np.newaxis], 0.02)
        fastest = np.maximum(fastest, np.abs(state.joint_velocities[0]))
    assert np.all(fastest <= 1.02 * robot.max_joint_velocity)
    assert np.any(fastest >= 0.9 * robot.max_joint_velocity)


def test_a_continuous_joint_takes_the_shorter_way():
    robot = load_robot("pr2")
    world, home = PyBulletBackend(robot), robot.home["home"].copy()
    home[-1] = 3.0
    base = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    world.reset(base, home[np.newaxis])
    home[-1] = -3.0
    seen = [3.0]
    for _ in range(50):
        seen.append(world.step(twist(), home[np.newaxis], 0.02).joint_positions[0, -1])
    world.close()
    assert seen[-1] == pytest.approx(-3.0, abs=1e-4)
    assert np.abs(seen).min() > 2.9


def test_without_its_springs_the_pr2_could_not_carry_its_arm():
    robot = load_robot("pr2")
    world = PyBulletBackend(robot)
    joints = np.array([[0.0, 0.0, 0.0, -0.2, 0.0, -0.2, 0.0]])
    world.reset(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), joints)
    body, zeros = world.sims[0].body, [0.0] * len(world.sims[0].body.joints)
    load = world.sims[0].physics.client.calculateInverseDynamics(
        body.body, body.positions(), zeros, zeros
    )
    shoulder = list(body.joints).index("r_shoulder_lift_joint")
    assert abs(load[shoulder]) > robot.urdf.joints["r_shoulder_lift_joint"].effort
    for _ in range(50):
        state = world.step(twist(), joints, 0.02)
    world.close()
    np.testing.assert_allclose(state.joint_positions, joints, atol=1e-3)


def test_a_joint_without_effort_is_refused():
    robot = load_robot("tiago")
    joints = dict(robot.urdf.joints)
    joints["arm_3_joint"] = replace(joints["arm_3_joint"], effort=0.0)
    weak = replace(robot, urdf=replace(robot.urdf, joints=joints))
    with pytest.raises(KinfeasError, match="'arm_3_joint'"):
        PyBulletBackend(weak).simulation(0)
