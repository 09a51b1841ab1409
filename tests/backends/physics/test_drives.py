from dataclasses import replace

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.backends.mujoco import simulations
from kinfeas.backends.physics import drives
from kinfeas.backends.physics.drives import cubic
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from tests.backends.conftest import place, stay
from tests.builders import twist

NUMBER = st.floats(-2.0, 2.0)
STEP = 1 / 240


@given(NUMBER, NUMBER, NUMBER, st.floats(0.05, 2.0))
def test_a_cubic_meets_its_boundary_conditions(position, velocity, change, duration):
    time = np.array([0.0, 1e-7, duration, 2.0 * duration])
    path, speed = np.array([cubic(position, velocity, change, duration, one) for one in time]).T
    assert (path[0], speed[0]) == (position, velocity)
    assert (path[1] - path[0]) / 1e-7 == pytest.approx(velocity, abs=1e-2)
    np.testing.assert_allclose(path[2:], position + change, atol=1e-9)
    np.testing.assert_allclose(speed[2:], 0.0, atol=1e-9)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_cubic_keeps_the_velocity_it_was_scaled_for(start, share):
    duration = 1.5 * max(share, 0.1)
    speed = [cubic(0.0, start, share, duration, time)[1] for time in np.linspace(0, 2, 99)]
    assert np.abs(speed).max() <= 1.0 + 1e-9


def test_joints_use_and_keep_their_velocity_limits(world, begin):
    begin(x=1.0)
    robot, rng = world.robot, np.random.default_rng(0)
    lower, upper = (np.clip(limit, -1.5, 1.5) for limit in robot.joint_limits)
    fastest = np.zeros(len(robot.arm))
    for _ in range(6):
        target = rng.uniform(lower, upper)[np.newaxis]
        for _ in range(15):
            speed = np.abs(world.step(twist(), target, 0.02).joint_velocities[0])
            fastest = np.maximum(fastest, speed / robot.max_joint_velocity)
    assert np.all(fastest <= 1.05)
    assert np.any(fastest >= 0.9)


def test_a_continuous_joint_takes_the_shorter_way(opened):
    world = opened(load_robot("pr2"))
    home = world.robot.home["home"].copy()
    home[-1] = 3.0
    place(world, joints=home)
    home[-1] = -3.0
    seen = [3.0]
    for _ in range(50):
        seen.append(world.step(twist(), home[np.newaxis], 0.02).joint_positions[0, -1])
    assert np.abs(seen).max() <= np.pi
    assert seen[-1] == pytest.approx(-3.0, abs=1e-4)
    assert np.abs(seen).min() > 2.9


def test_kernels_are_compiled_before_the_first_step(opened, monkeypatch):
    types = []

    def recorded(kernel):
        def run(*arguments):
            types.append((kernel, tuple(map(numba.typeof, arguments))))
            return kernel(*arguments)

        return run

    monkeypatch.setattr(drives, "arm_paths", recorded(drives.arm_paths))
    monkeypatch.setattr(simulations, "base_path", recorded(simulations.base_path))
    world = opened(load_robot("hsr"))
    place(world)
    compiled = set(types)
    world.step(twist(0.1), world.robot.home["home"][np.newaxis], 0.02)
    assert set(types) == compiled != set()


def test_a_joint_without_effort_is_an_error(engine):
    robot = load_robot("tiago")
    joints = dict(robot.urdf.joints)
    joints["arm_3_joint"] = replace(joints["arm_3_joint"], effort=0.0)
    with pytest.raises(KinfeasError, match="'arm_3_joint'"):
        engine(replace(robot, urdf=replace(robot.urdf, joints=joints))).open()


@pytest.mark.parametrize("command", [twist(0.2), twist(0.2, 0.1, -0.4), twist(turn=0.4)])
def test_the_base_keeps_its_acceleration_limits(world, begin, command):
    begin()
    states = stay(world, 120, command, STEP) + stay(world, 120, twist(), STEP)
    speed = np.array([state.base_twist[0, [0, 1, 5]] for state in states])
    change = np.diff(speed, axis=0, prepend=0.0) / STEP
    base = world.robot.base
    assert np.hypot(change[:, 0], change[:, 1]).max() <= base.max_acceleration * 1.01
    assert np.abs(change[:, 2]).max() <= base.max_rotation_acceleration * 1.01


def test_an_omnidirectional_base_reaches_its_velocity_and_stops(world, begin):
    begin()
    states = stay(world, 50, twist(0.15, 0.1))
    np.testing.assert_allclose(states[-1].base_twist, twist(0.15, 0.1), atol=1e-5)
    x = states[-1].base_pose[0, 0]
    assert 0.13 <= x <= 0.15
    states = stay(world, 50)
    np.testing.assert_allclose(states[-1].base_twist, twist(), atol=1e-5)
    assert x <= states[-1].base_pose[0, 0] <= x + 0.02


def test_a_differential_drive_moves_along_its_heading(opened):
    world, rng = opened(load_robot("tiago")), np.random.default_rng(0)
    place(world, yaw=0.7)
    for _ in range(100):
        x, y, turn = rng.uniform(-0.2, 0.2, 3)
        (state,) = stay(world, 1, twist(x, y, 2.0 * turn))
        heading = spatial.yaw(state.base_pose)[0]
        assert abs([-np.sin(heading), np.cos(heading)] @ state.base_twist[0, :2]) <= 1e-3
    place(world, yaw=0.7)  # it follows the part along its heading
    state = stay(world, 50, twist(0.1))[-1]
    assert np.linalg.norm(state.base_twist[0, :2]) == pytest.approx(0.1 * np.cos(0.7), abs=1e-3)


def test_a_wall_stops_the_base(world, begin):
    begin(x=-2.3, yaw=np.pi)
    before = stay(world, 150, twist(-0.2))[-1].base_pose
    after = stay(world, 25, twist(-0.2))[-1].base_pose
    assert np.linalg.norm(after[0, :2] - before[0, :2]) <= 0.005
