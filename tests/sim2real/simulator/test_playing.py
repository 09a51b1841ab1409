import time

import pytest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link.fault import Fault

pytest.importorskip("pybullet")

from kinfeas.sim2real.simulator import playing
from kinfeas.sim2real.simulator.playing import play, robot_link
from kinfeas.sim2real.simulator.simulated_robot import Role, SimulatedRobot
from kinfeas.sim2real.simulator.spawn import set_stage


@pytest.fixture(scope="module")
def player(robot):
    """A robot at home, at the origin."""
    backend, state = set_stage(robot)
    yield SimulatedRobot(backend, state, Role())
    backend.close()


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
    monkeypatch.setattr(playing, "_LINGER", 0.1)
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
    with pytest.raises(RuntimeError) as caught:
        play(player, memory, Role(rate=50.0, seconds=0.1), lambda: None)
    assert caught.value.__notes__ == ["raised by robot link Memory"]


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
        (None, "must return a RobotLink from robot_link, not NoneType$"),
    ],
)
def test_a_backend_whose_end_for_the_robot_is_broken_is_one_sentence(monkeypatch, answer, sentence):
    monkeypatch.setattr(registry, "_REGISTERED", [])
    monkeypatch.setattr(Hosting, "answer", answer)
    registry.register("kinfeas.backends", "hosting", Hosting)
    with pytest.raises(KinfeasError, match=f"^backend 'hosting' {sentence}"):
        robot_link("hosting", load_robot("pr2"))


def test_a_backend_must_be_on_a_bus():
    robot = load_robot("pr2")
    with pytest.raises(KinfeasError, match="backend 'analytic' is on no bus that a robot can be"):
        robot_link("analytic", robot)
    with pytest.raises(KinfeasError, match="unknown backend 'ros3'"):
        robot_link("ros3", robot)
    assert robot_link("ros1", robot).close() is None
