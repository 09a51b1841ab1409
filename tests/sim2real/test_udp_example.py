"""The transport of examples/udp_backend.py."""

import socket
import time
import types
from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.backend import RealTimeBackend
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.watchdog import Watched
from kinfeas.sim2real.link import BaseReading, Hosted, Orders
from tests.sim2real.doubles import joints_at

EXAMPLE = Path(__file__).parents[2] / "examples" / "udp_backend.py"


@pytest.fixture
def udp():
    """The example as a module, on ports that are free."""
    module = types.ModuleType("udp")
    exec(compile(EXAMPLE.read_text(), str(EXAMPLE), "exec"), module.__dict__)
    free = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for one in free:
        one.bind(("127.0.0.1", 0))
    module.OURS, module.ROBOTS = (one.getsockname() for one in free)
    for one in free:
        one.close()
    return module


@pytest.fixture
def orders():
    """What the robot was told, by kind."""
    return {"drive": [], "move": [], "grip": []}


@pytest.fixture
def robots_end(udp, orders):
    pr2 = load_robot("pr2")
    link = udp.UdpBackend.robot_link(pr2)
    link.open(Orders(*(orders[name].append for name in ("drive", "move", "grip"))))
    yield link
    link.close()


def wait(condition):
    end = time.monotonic() + 60.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def test_carries_everything_both_ways(udp, orders, robots_end):
    pr2 = load_robot("pr2")
    backend = udp.UdpBackend(pr2, seconds=0.25)
    assert isinstance(backend, RealTimeBackend)
    assert isinstance(backend, Watched)
    assert isinstance(udp.UdpBackend, Hosted)
    backend.link.open(backend._inbox.readings())
    backend._opened = True
    base = BaseReading(1.0, 2.0, np.pi / 2, np.array([0.1, 0.0, 0.2]), stamp=5.0)
    robots_end.report(base, joints_at(pr2))
    wait(lambda: not any(backend._inbox.missing()))
    state = backend.read()
    np.testing.assert_allclose(state.base_pose[0, :2], [1.0, 2.0])
    np.testing.assert_allclose(state.base_twist[0], [0, 0.1, 0, 0, 0, 0.2], atol=1e-12)
    np.testing.assert_array_equal(state.joint_positions[0], pr2.home["home"])
    targets = pr2.home["home"] + 0.01
    backend.step(np.array([[0.0, 0.2, 0.0, 0.0, 0.0, 0.3]]), targets[np.newaxis], 0.002)
    backend.grip("close", np.array([0]))
    wait(lambda: all(orders.values()))
    np.testing.assert_allclose(orders["drive"][0], [0.2, 0.0, 0.3], atol=1e-12)
    path = orders["move"][0]
    assert path.joints == tuple(joint.name for joint in pr2.arm)
    np.testing.assert_array_equal(path.times, [0.25])
    np.testing.assert_allclose(path.positions, [targets])
    assert orders["grip"] == ["close"]
    backend.close()


def test_the_watchdogs_function_stops_the_base(udp, orders, robots_end):
    stop = udp.stop_base()
    stop()
    wait(lambda: orders["drive"])
    np.testing.assert_array_equal(orders["drive"][0], np.zeros(3))
