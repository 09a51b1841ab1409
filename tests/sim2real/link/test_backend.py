import shutil
import socket
import types
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from kinfeas.core.backend import SCAN_BEAMS, RealTimeBackend
from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.core.response import ResponseModel
from kinfeas.kinematics import drive
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.guards import Guarded
from kinfeas.sim2real.link import BaseReading, JointReading, Orders
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.scans import CostmapReading, LaserReading
from tests.builders import at, twist, wait
from tests.sim2real.conftest import MemoryLink, connected, joints_at, present

DT = 0.02
PR2 = load_robot("pr2")
ARM = [joint.name for joint in PR2.arm]
AT_HOME = PR2.home["home"][np.newaxis]
ELBOW, ROLL = ARM.index("r_elbow_flex_joint"), ARM.index("r_forearm_roll_joint")


@pytest.fixture
def ends(time):
    return connected(PR2, time)


def test_reset_leaves_the_robot_where_it_is(ends):
    backend, link = ends
    assert isinstance(backend, RealTimeBackend)
    assert backend.gripper is backend
    state = backend.read()
    np.testing.assert_allclose(state.base_pose, at(1.0, 2.0, 0.5))
    np.testing.assert_array_equal(state.joint_positions, AT_HOME)
    assert state.age[0] == 0.0
    assert link.driven == link.moved == []


def test_the_response_of_a_robots_file_is_that_of_its_backend(tmp_path):
    folder = shutil.copytree(PR2.folder, tmp_path / "late")
    with (folder / "robot.yaml").open("a") as file:
        file.write("\nresponse: {command_latency: 0.05, base_lag: 0.1, acceleration: 0.8}\n")
    robot = load_robot(folder)
    response = ResponseModel(command_latency=0.05, base_lag=0.1, acceleration=0.8)
    assert LinkBackend(robot, MemoryLink()).response == robot.response == response
    assert LinkBackend(PR2, MemoryLink()).response.immediate


@pytest.mark.parametrize(("answer", "deaf", "named"), [
    (lambda readings: readings.joints(joints_at(PR2)), None, "/odometer"),
    (lambda readings: readings.base(BaseReading(0.0, 0.0, 0.0)), None, "/encoders"),
    (present(PR2), "/cmd_vel", "/cmd_vel"),
    (present(PR2, joints=JointReading(dict.fromkeys(ARM[:-1], 0.0))), None, ARM[-1]),
    (present(PR2, joints=joints_at(PR2, torso_lift_joint=0.5)), None, "torso_lift_joint"),
    (present(PR2, joints=joints_at(PR2, torso_lift_joint=-0.5)), None, "torso_lift_joint"),
])  # fmt: skip
def test_errors_of_reset_name_the_missing_part(answer, deaf, named):
    with pytest.raises(KinfeasError, match=named):
        LinkBackend(PR2, MemoryLink(answer, deaf), timeout=0.05).reset(None, None)


@pytest.mark.parametrize("name", ["pr2", "tiago"])
def test_the_base_gets_the_action_of_the_policy_in_its_own_frame(name, time):
    robot, rng = load_robot(name), np.random.default_rng(0)
    backend, link = connected(robot, time, yaw=2.5)
    pose, home = backend.read().base_pose, robot.home["home"][np.newaxis]
    for _ in range(20):
        action = 0.7 * rng.uniform(-1.0, 1.0, (1, drive.command_size(robot.base)))
        backend.step(drive.base_twist(robot.base, pose, action, DT), home, DT)
        forward, left, turn = link.driven[-1]
        sent = [forward, left][: action.shape[1] - 1]
        np.testing.assert_allclose(sent, action[0, :-1] * robot.base.max_velocity, atol=1e-12)
        assert turn == pytest.approx(action[0, -1] * robot.base.max_rotation)
        if robot.base.drive == "differential":
            assert left == 0.0


def test_a_heading_that_nobody_has_checked_turns_no_command(ends):
    backend, link = ends
    pose = backend.read().base_pose
    link.readings.base(BaseReading(1.0, 2.0, 0.5 + np.pi))
    backend.step(drive.base_twist(PR2.base, pose, np.array([[1.0, 0.0, 0.0]]), DT), AT_HOME, DT)
    np.testing.assert_allclose(link.driven[-1], [PR2.base.max_velocity, 0.0, 0.0], atol=1e-12)


def test_joints_outside_the_arm_are_checked_by_the_robots_own_names(time):
    link = MemoryLink(present(PR2, joints=joints_at(PR2, torso=0.3)))
    backend = LinkBackend(PR2, link, names={"torso_lift_joint": "torso"}, clock=time.clock)
    with pytest.raises(KinfeasError, match="torso_lift_joint"):
        backend.reset(None, None)


def test_the_arm_is_sent_by_the_robots_own_names(time):
    positions = dict(joints_at(PR2).positions)
    positions["elbow"] = positions.pop(ARM[ELBOW])
    link = MemoryLink(present(PR2, joints=JointReading(positions)))
    backend = LinkBackend(PR2, link, names={ARM[ELBOW]: "elbow"}, seconds=0.25, clock=time.clock)
    state = backend.reset(None, None)
    np.testing.assert_array_equal(state.joint_positions, AT_HOME)
    backend.step(twist(), AT_HOME, DT)
    sent, seconds = link.moved[-1]
    assert list(sent) == [*ARM[:ELBOW], "elbow", *ARM[ELBOW + 1 :]]
    np.testing.assert_allclose(list(sent.values()), AT_HOME[0])
    assert seconds == 0.25


@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_continuous_joints_go_the_short_way(ends, turns):
    backend, link = ends
    measured, targets = 3.0 + turns * 2.0 * np.pi, AT_HOME.copy()
    link.readings.joints(JointReading({ARM[ROLL]: measured}))
    targets[0, ROLL] = -3.0
    backend.read()
    backend.step(twist(), targets, DT)
    assert link.moved[-1][0][ARM[ROLL]] == pytest.approx(measured + 2.0 * np.pi - 6.0)


def test_no_joint_is_sent_faster_than_its_limit(ends):
    backend, link = ends
    fastest = PR2.max_joint_velocity
    for limit in (None, 0.2, 99.0):
        if limit is not None:
            backend.limit_arm(limit * fastest)
        backend.step(twist(), AT_HOME + np.eye(7)[ELBOW], DT)
        # The peak of a cubic from rest is 1.5 times its mean.
        seconds = pytest.approx(1.5 / (min(limit or 1.0, 1.0) * fastest[ELBOW]))
        assert link.moved[-1][1] == seconds
        backend.stop()  # without a newer measurement: the arm may be at its target already
        np.testing.assert_allclose(list(link.moved[-1][0].values()), AT_HOME[0])
        assert link.moved[-1][1] == seconds


def test_steps_keep_the_rate_and_return_the_newest_state(ends, time):
    backend, link = ends
    start, prepared = time.monotonic, []
    backend.prepare = lambda: prepared.append(len(link.driven))
    for x in (3.0, 4.0):
        link.readings.base(BaseReading(x, 0.0, 0.0))
        state = backend.step(twist(), AT_HOME, DT)
        assert state.base_pose[0, 0] == x
    assert time.monotonic - start == pytest.approx(2 * DT)
    assert state.age[0] == pytest.approx(2 * DT)  # of the joints
    assert backend.rate.timing().periods == 2
    assert prepared == [1, 2]  # after each command


def test_stop_commands_zero_and_holds_the_arm(ends):
    backend, link = ends
    backend.stop()
    assert link.moved == []  # nothing has moved it
    link.readings.joints(JointReading({ARM[ELBOW]: -1.25, ARM[ROLL]: 9.0}))
    backend.step(twist(), backend.read().joint_positions, DT)
    for _ in range(2):
        backend.stop()
        np.testing.assert_array_equal(link.driven[-1], np.zeros(3))
        held = link.moved[-1][0]
        assert held[ARM[ELBOW]] == -1.25
        assert held[ARM[ROLL]] == pytest.approx(9.0)
    link.drive = Mock(side_effect=Fault("base"))
    for error in (None, KeyError("arm")):  # the arm holds even if the base cannot be stopped
        link.move = Mock(side_effect=error)
        with pytest.raises(Fault, match="base"):
            backend.stop()
        link.move.assert_called_once()


def test_a_false_measurement_does_not_move_the_arm(time):
    """One joint is measured wrong for some periods, as by a bad encoder or a second robot."""
    link, fastest = MemoryLink(present(PR2)), PR2.max_joint_velocity
    guard = Guarded(LinkBackend(PR2, link, clock=time.clock), PR2, clock=time.clock)
    guard.reset(None, None)
    for false in (0.0, 0.0, 3.0):
        link.readings.base(BaseReading(1.0, 2.0, 0.5))
        link.readings.joints(joints_at(PR2, AT_HOME[0] + false * np.eye(7)[ELBOW]))
        with pytest.raises(Fault) if false else nullcontext():
            guard.step(twist(), AT_HOME - 0.01 * np.eye(7)[ELBOW], DT)
    guard.stop()
    guard.close()
    for sent, seconds in link.moved:
        off = np.abs(np.array(list(sent.values())) - AT_HOME[0])
        assert np.all(off <= np.minimum(0.011, fastest * seconds / 1.5))
    assert len(link.moved) > 4  # the stop repeats


@pytest.mark.parametrize(("base", "joints", "named"), [
    (None, joints_at(PR2), "/odometer"),
    (BaseReading(1.0, 2.0, 0.5), None, "joint positions came from /encoders"),
    (BaseReading(1.0, 2.0, 0.5), JointReading(dict.fromkeys(ARM[:-1], 0.0)), f"of {ARM[-1]} came"),
])  # fmt: skip
def test_a_source_that_falls_silent_is_named(ends, time, base, joints, named):
    backend, link = ends
    time.passes(0.3)
    if base is not None:
        link.readings.base(base)
    if joints is not None:
        link.readings.joints(joints)
    assert named in backend.silent_source(0.2)
    assert not backend.silent_source(0.4)
    with pytest.raises(Fault, match=f"{named}.* s old"):
        Guarded(backend, PR2, clock=time.clock).read()


def test_a_broken_link_or_useless_measurements_are_faults_that_send_nothing(ends):
    backend, link = ends
    link.check.side_effect = Fault("cable")
    for _ in range(2):
        with pytest.raises(Fault, match=r"cable|is not finite"):
            backend.step(np.full((1, 6), 0.1), AT_HOME, DT)
        link.check.side_effect = None
        link.readings.base(BaseReading(0.0, np.nan, 0.0))
    assert link.driven == link.moved == []
    link.check.side_effect = Fault("cable")
    with pytest.raises(Fault, match="cable"):
        backend.reset(None, None)


def test_grips_and_closes_once(ends):
    backend, link = ends
    backend.grip("close", np.array([], dtype=np.intp))
    backend.grip("open", np.array([0]))
    assert link.gripped == ["open"]
    backend.close()
    backend.close()
    backend.stop()
    assert (link.close.call_count, len(link.driven)) == (1, 1)


def test_scans_have_the_ranges_and_the_age_of_their_sources(ends, time):
    assert ends[0].scanner is None
    link = MemoryLink(present(PR2))
    link.scan_sources = {}  # topics without laser and costmap
    assert LinkBackend(PR2, link).scanner is None
    link.scan_sources = {LaserReading: "/scan", CostmapReading: "/costmap"}
    backend = LinkBackend(PR2, link, clock=time.clock, timeout=1.0)
    backend.reset(None, None)
    assert backend.scanner is backend
    link.readings.scan(LaserReading(np.full(SCAN_BEAMS, 2.0), -np.pi, 2.0 * np.pi / SCAN_BEAMS))
    with pytest.raises(KinfeasError, match="/costmap"):
        backend.scan()
    time.passes(0.25)
    cells = np.full((10, 10), 100, dtype=np.int8)
    cells[1:-1, 1:-1] = 0
    link.readings.scan(CostmapReading(cells, 0.1, (0.5, 1.5, 0.0)))  # the robot is at (1, 2)
    scan = backend.scan()
    assert scan.age == pytest.approx(1.25, abs=0.1)
    assert not scan.blind.any()
    np.testing.assert_allclose(scan.ranges[0, 0], 2.0)
    assert np.all((scan.ranges[0, 1] > 0.39) & (scan.ranges[0, 1] < 0.65))


EXAMPLE = Path(__file__).parents[3] / "examples" / "udp_backend.py"


def test_the_udp_example_carries_measurements_commands_and_stops(hsr):
    udp, orders = types.ModuleType("udp"), {"drive": [], "move": [], "grip": []}
    exec(compile(EXAMPLE.read_text(), str(EXAMPLE), "exec"), vars(udp))
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as two:
        for port in (one, two):  # which are free
            port.bind(("127.0.0.1", 0))
        udp.OURS, udp.ROBOTS = one.getsockname(), two.getsockname()
    theirs, ours = udp.UdpBackend.robot_link(hsr), udp.UdpBackend(hsr, seconds=0.25)
    assert isinstance(ours, RealTimeBackend)
    assert ours.stop_call() is not None
    theirs.open(Orders(*(orders[name].append for name in ("drive", "move", "grip"))))
    ours.link.open(ours._inbox.readings())
    ours._opened = True
    for junk in (b"5", b"[]", b'{"base": 0}', b'{"drive"'):  # of somebody else
        ours.link.port.socket.sendto(junk, udp.ROBOTS)
        theirs.port.socket.sendto(junk, udp.OURS)
    base = BaseReading(1.0, 2.0, np.pi / 2, np.array([0.1, 0.0, 0.2]), stamp=5.0)
    theirs.report(base, joints_at(hsr), None)
    wait(lambda: not any(ours._inbox.missing()))
    state = ours.read()
    np.testing.assert_allclose(state.base_pose[0, :2], [1.0, 2.0])
    np.testing.assert_allclose(state.base_twist[0], [0, 0.1, 0, 0, 0, 0.2], atol=1e-12)
    targets = hsr.home["home"] + 0.01
    ours.step(np.array([[0.0, 0.2, 0.0, 0.0, 0.0, 0.0]]), targets[np.newaxis], 0.002)
    ours.grip("close", np.array([0]))
    wait(lambda: all(orders.values()))
    np.testing.assert_allclose(orders["drive"][0], [0.2, 0.0, 0.0], atol=1e-12)
    path = orders["move"][0]
    assert path.joints == tuple(joint.name for joint in hsr.arm)
    np.testing.assert_allclose(path.positions, [targets])
    udp.stop_base()()
    wait(lambda: not orders["drive"][-1].any())
    ours.close()
    theirs.close()
