import time

import numpy as np
import pytest

from kinfeas.sim2real.link import JointPath

pytest.importorskip("pybullet")

from kinfeas.sim2real.simulator.simulated_robot import Role, SimulatedRobot
from kinfeas.sim2real.simulator.spawn import set_stage

TICK = 0.01


@pytest.fixture(scope="module")
def stage(robot):
    backend, state = set_stage(robot)
    yield backend, state
    backend.close()


@pytest.fixture
def player(stage, robot):
    """A robot at home, at the origin, whose base waits long for commands."""
    backend, state = stage
    backend.reset(state.base_pose, state.joint_positions)
    return SimulatedRobot(backend, state, Role(command_timeout=60.0))


def test_drives_as_it_is_told(player, robot):
    sideways = 0.1 if robot.base.drive == "omnidirectional" else 0.0
    player.orders().drive(np.array([0.2, 0.1, 0.0]))
    for _ in range(100):
        player.tick(TICK)
    base, _ = player.measure()
    np.testing.assert_allclose(base.velocity, [0.2, sideways, 0.0], atol=0.01)
    assert base.x == pytest.approx(0.2, abs=0.04)
    assert base.y == pytest.approx(sideways, abs=0.03)


def test_velocities_are_in_the_base_frame(player):
    for velocity, ticks in (([0.0, 0.0, 0.4], 200), ([0.2, 0.0, 0.0], 60)):
        player.orders().drive(np.array(velocity))
        for _ in range(ticks):
            player.tick(TICK)
    base, _ = player.measure()
    assert base.yaw == pytest.approx(0.8, abs=0.15)
    assert np.arctan2(base.y, base.x) == pytest.approx(base.yaw, abs=0.1)
    np.testing.assert_allclose(base.velocity, [0.2, 0.0, 0.0], atol=0.02)


def test_the_base_stops_by_itself(stage, robot):
    backend, state = stage
    backend.reset(state.base_pose, state.joint_positions)
    player = SimulatedRobot(backend, state, Role(command_timeout=0.05))
    player.orders().drive(np.array([0.2, 0.0, 0.0]))
    for _ in range(20):
        player.tick(TICK)
    assert player.timeouts == 0 or player.measure()[0].velocity[0] < 0.2
    time.sleep(0.06)
    for _ in range(40):
        player.tick(TICK)
    assert player.timeouts == 1
    np.testing.assert_allclose(player.measure()[0].velocity, 0.0, atol=0.005)


def test_joints_follow_their_ways_and_are_reported_by_name(player, robot):
    name, home = robot.arm[-1].name, robot.home["home"][-1]
    _, before = player.measure()
    assert before.positions[name] == pytest.approx(home, abs=1e-6)
    assert set(robot.fixed_joints) <= set(before.positions)
    assert not any(joint.startswith("planar") for joint in before.positions)
    goal = home + 0.3
    player.orders().move(JointPath((name,), np.array([0.01]), np.array([[goal]])))
    for _ in range(60):
        player.tick(TICK)
    _, after = player.measure()
    assert after.positions[name] == pytest.approx(goal, abs=0.02)
    assert after.positions[robot.arm[0].name] == pytest.approx(robot.home["home"][0], abs=0.02)


def test_grips(player, robot):
    finger = robot.gripper.fingers[0]
    openings = []
    for grip in ("open", "close"):
        player.orders().grip(grip)
        for _ in range(150):
            player.tick(TICK)
        openings.append(player.measure()[1].positions[finger])
    assert openings[0] == pytest.approx(robot.gripper.open, rel=0.1)
    assert openings[1] < 0.5 * openings[0]
