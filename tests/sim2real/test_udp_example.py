import socket
import types
from pathlib import Path

import numpy as np
import pytest

from kinfeas.core.backend import RealTimeBackend
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link import BaseReading, Orders
from tests.builders import wait
from tests.sim2real.doubles import joints_at

EXAMPLE = Path(__file__).parents[2] / "examples" / "udp_backend.py"


@pytest.fixture
def udp():
    """The example as a module, on ports that are free."""
    module = types.ModuleType("udp")
    exec(compile(EXAMPLE.read_text(), str(EXAMPLE), "exec"), module.__dict__)
    ports = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for port in ports:
        port.bind(("127.0.0.1", 0))
    module.OURS, module.ROBOTS = (port.getsockname() for port in ports)
    for port in ports:
        port.close()
    return module


def test_carries_measurements_commands_and_stops(udp):
    robot = load_robot("hsr")
    orders = {"drive": [], "move": [], "grip": []}
    theirs, ours = udp.UdpBackend.robot_link(robot), udp.UdpBackend(robot, seconds=0.25)
    assert isinstance(ours, RealTimeBackend)
    assert ours.stop_call() is not None
    theirs.open(Orders(*(orders[name].append for name in ("drive", "move", "grip"))))
    ours.link.open(ours._inbox.readings())
    ours._opened = True
    base = BaseReading(1.0, 2.0, np.pi / 2, np.array([0.1, 0.0, 0.2]), stamp=5.0)
    theirs.report(base, joints_at(robot), None)
    wait(lambda: not any(ours._inbox.missing()))
    state = ours.read()
    np.testing.assert_allclose(state.base_pose[0, :2], [1.0, 2.0])
    np.testing.assert_allclose(state.base_twist[0], [0, 0.1, 0, 0, 0, 0.2], atol=1e-12)
    targets = robot.home["home"] + 0.01
    ours.step(np.array([[0.0, 0.2, 0.0, 0.0, 0.0, 0.0]]), targets[np.newaxis], 0.002)
    ours.grip("close", np.array([0]))
    wait(lambda: all(orders.values()))
    np.testing.assert_allclose(orders["drive"][0], [0.2, 0.0, 0.0], atol=1e-12)
    path = orders["move"][0]
    assert path.joints == tuple(joint.name for joint in robot.arm)
    np.testing.assert_allclose(path.positions, [targets])
    udp.stop_base()()
    wait(lambda: not orders["drive"][-1].any())
    ours.close()
    theirs.close()
