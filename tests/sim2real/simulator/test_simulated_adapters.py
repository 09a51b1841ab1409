"""Adapters around a simulated robot, as programs on its bus meet them."""

import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.config.recipes import default_engine
from kinfeas.core.spatial import yaw
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.simulator.simulation import SimulatedRobot, spawn, world_of

TICK = 0.01


@pytest.fixture
def late(time):
    """A robot with late commands and measurements, and noise on its joints."""
    pytest.importorskip(default_engine())
    adapters = [
        PluginSpec("command_latency", {"seconds": 0.1}),
        PluginSpec("joint_noise", {"deviation": 0.01}),
        PluginSpec("sensor_latency", {"seconds": 0.05}),
    ]
    backend, state = spawn(load_robot("hsr"), adapters=adapters)
    yield SimulatedRobot(backend, state, 5.0, time.clock), world_of(backend)
    backend.close()


def test_commands_and_measurements_are_late_and_stamped_as_such(late, time):
    robot, world = late
    robot.orders().drive(np.array([0.0, 0.0, 0.5]))
    headings, shown, stamps = [], [], []
    for _ in range(50):
        robot.step(TICK)
        time.passes(TICK)
        base, _ = robot.measure()
        headings.append(float(yaw(world._measure(np.array([0])).base_pose)[0]))
        shown.append(base.yaw)
        stamps.append(time.wall - base.stamp)
    assert max(headings[:9]) < 1e-3 < headings[20]
    assert stamps[20:] == pytest.approx([0.05] * 30, abs=1e-6)
    np.testing.assert_allclose(shown[20:], headings[15:45], atol=1e-6)


def test_noise_is_measured_at_the_arm_only(late, time):
    robot, _ = late
    positions = []
    for _ in range(40):
        robot.step(TICK)
        time.passes(TICK)
        positions.append(robot.measure()[1].positions)
    arm, other = load_robot("hsr").arm[1].name, next(iter(load_robot("hsr").fixed_joints))
    assert np.std([each[arm] for each in positions[10:]]) == pytest.approx(0.01, rel=0.5)
    assert np.std([each[other] for each in positions[10:]]) < 1e-3
