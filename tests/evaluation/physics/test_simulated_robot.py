import time

import numpy as np
import pytest

from kinfeas import registry
from kinfeas.errors import KinfeasError
from kinfeas.sim2real.fault import Fault
from kinfeas.sim2real.link import JointPath
from kinfeas.tasks.loading import load_task

pytest.importorskip("pybullet")

from kinfeas.evaluation.physics import simulated_robot
from kinfeas.evaluation.physics.simulated_robot import (
    Role,
    SimulatedRobot,
    play,
    robot_link,
    set_stage,
)

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


class Memory:
    """A bus that carries what the test says and keeps what is reported."""

    def __init__(self, fault=None):
        self.reports, self.closed, self.fault = [], 0, fault

    def open(self, orders):
        self.orders = orders

    def check(self):
        if self.fault:
            raise Fault(self.fault)

    def report(self, base, joints):
        self.reports.append((base, joints))

    def close(self):
        self.closed += 1


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


def test_is_played_in_real_time(player):
    memory, begin, told = Memory(), time.monotonic(), []
    played = play(player, memory, Role(rate=50.0, seconds=0.5), lambda: told.append(True))
    assert 0.5 <= time.monotonic() - begin < 1.5
    assert 0.5 <= played.seconds < 1.5
    assert told == [True]
    assert memory.closed == 1
    assert 5 < len(memory.reports) <= 27
    stamps = [base.stamp for base, _ in memory.reports]
    assert stamps == sorted(stamps)


def test_a_robot_goes_on_for_a_while_when_its_bus_breaks(player, monkeypatch):
    monkeypatch.setattr(simulated_robot, "_LINGER", 0.1)
    memory = Memory(fault="the master died")
    with pytest.raises(KinfeasError, match="the master died"):
        play(player, memory, Role(rate=50.0), lambda: None)
    assert len(memory.reports) > 2
    assert memory.closed == 1


@pytest.mark.parametrize("method", ["open", "report", "check", "close"])
def test_a_link_from_outside_that_fails_is_one_sentence(player, monkeypatch, method):
    memory = Memory()

    def fails(*_):
        raise RuntimeError("boom")

    monkeypatch.setattr(memory, method, fails)
    with pytest.raises(KinfeasError, match=rf"^robot link Memory fails in {method}: Runtime.*line"):
        play(player, memory, Role(rate=50.0, seconds=0.1), lambda: None)


class Hosting:
    """A backend whose end for the robot is broken."""

    answer = None

    @classmethod
    def robot_link(cls, robot, topics=None):
        if isinstance(cls.answer, Exception):
            raise cls.answer
        return cls.answer


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (RuntimeError("boom"), r"fails in robot_link: RuntimeError: boom \(test_sim.*line \d+\)$"),
        (None, "must return a RobotLink from robot_link, not NoneType$"),
    ],
)
def test_a_backend_whose_end_for_the_robot_is_broken_is_one_sentence(monkeypatch, answer, sentence):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    monkeypatch.setattr(Hosting, "answer", answer)
    registry.register("kinfeas.backends", "hosting", Hosting)
    with pytest.raises(KinfeasError, match=f"^backend 'hosting' {sentence}"):
        robot_link("hosting", registry.load_robot("pr2"))


def test_begins_as_an_episode_of_a_task_does():
    robot = registry.load_robot("pr2")
    task = load_task("drawer", {})
    places = []
    for number in (0, 0, 1):
        backend, state = set_stage(robot, task, numbers=(1, number))
        assert backend.furniture is not None
        places.append(state.base_pose[0, 0])
        backend.close()
    assert places[0] == places[1] != places[2]


def test_a_backend_must_be_on_a_bus():
    robot = registry.load_robot("pr2")
    with pytest.raises(KinfeasError, match="backend 'analytic' is on no bus that a robot can be"):
        robot_link("analytic", robot)
    with pytest.raises(KinfeasError, match="unknown backend 'ros3'"):
        robot_link("ros3", robot)
    assert robot_link("ros1", robot).close() is None
