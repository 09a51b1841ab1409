import threading
import time

import numpy as np
import pytest

from kinfeas.control import drive
from kinfeas.core import spatial
from kinfeas.core.backend import ArmLimited, RealTimeBackend, SupportsGripper
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.command_guard import CommandGuard
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.link.backend import LinkBackend, robot_names
from kinfeas.sim2real.link.fault import Fault
from tests.sim2real.links import MemoryLink, connected, joints_at, present

DT = 0.002


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


def still(robot):
    return np.zeros((1, 6)), robot.home["home"][np.newaxis].copy()


def test_is_what_the_loop_asks_for(pr2):
    backend, _ = connected(pr2)
    assert isinstance(backend, RealTimeBackend)
    assert isinstance(backend, SupportsGripper)
    assert isinstance(backend, ArmLimited)


def test_reset_leaves_the_robot_where_it_is(robot):
    link = MemoryLink(present(robot, x=1.0, y=2.0, yaw=0.5))
    state = LinkBackend(robot, link).reset(np.zeros((1, 7)), np.ones((1, len(robot.arm))))
    np.testing.assert_allclose(
        state.base_pose, spatial.planar_pose(*np.array([[1.0], [2.0], [0.5]]))
    )
    np.testing.assert_array_equal(state.joint_positions[0], robot.home["home"])
    assert 0.0 <= state.age[0] < 1.0
    assert link.driven == link.moved == []


def test_reset_waits_for_what_comes_late(pr2):
    def late(readings):
        threading.Timer(0.1, present(pr2), [readings]).start()

    assert LinkBackend(pr2, MemoryLink(late)).reset(None, None).base_pose[0, 0] == 1.0


def test_reset_measures_anew(pr2):
    backend, link = connected(pr2)
    link.readings.base(BaseReading(5.0, 0.0, 0.0, stamp=1e9))
    threading.Timer(0.05, present(pr2, x=7.0, stamp=5.0), [link.readings]).start()
    assert backend.reset(None, None).base_pose[0, 0] == 7.0


@pytest.mark.parametrize(
    ("answer", "deaf", "said"),
    [
        (lambda pr2, to: to.joints(joints_at(pr2)), None, "no pose of the base came from the odom"),
        (lambda _, to: to.base(BaseReading(0, 0, 0)), None, "no joint positions came from the enc"),
        (lambda pr2, to: present(pr2)(to), "/cmd_vel", "nobody listens to /cmd_vel within 0.1 s"),
    ],
)
def test_reset_says_what_is_silent(pr2, answer, deaf, said):
    link = MemoryLink(lambda readings: answer(pr2, readings), deaf)
    with pytest.raises(KinfeasError, match=f"{said}.*is the robot on") as error:
        LinkBackend(pr2, link, patience=0.1).reset(None, None)
    assert "\n" not in str(error.value)


def test_reset_says_which_joints_are_missing(pr2):
    def answer(readings):
        readings.base(BaseReading(0.0, 0.0, 0.0))
        readings.joints(JointReading({joint.name: 0.0 for joint in pr2.arm[:-1]}))

    with pytest.raises(KinfeasError, match="the encoders says nothing of r_wrist_roll_joint; it"):
        LinkBackend(pr2, MemoryLink(answer), patience=0.1).reset(None, None)


def test_reset_refuses_a_robot_whose_other_joints_stand_elsewhere(pr2):
    def answer(readings):
        readings.base(BaseReading(0.0, 0.0, 0.0))
        readings.joints(joints_at(pr2, torso_lift_joint=0.2))

    with pytest.raises(KinfeasError, match=r"torso_lift_joint stands at 0\.200, but"):
        LinkBackend(pr2, MemoryLink(answer)).reset(None, None)


def test_reset_stops_waiting_when_the_link_breaks(pr2):
    link = MemoryLink()
    link.broken = "the master died"
    with pytest.raises(Fault, match="the master died"):
        LinkBackend(pr2, link).reset(None, None)


def test_the_base_is_told_what_the_policy_wants_in_its_own_frame(robot):
    backend, link = connected(robot, yaw=2.5)
    pose = backend.read().base_pose
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = rng.uniform(-1.0, 1.0, (1, drive.action_size(robot.base)))
        backend.step(drive.base_twist(robot.base, pose, action, DT), still(robot)[1], DT)
        forward, left, turn = link.driven[-1]
        wanted = action[0] * robot.base.max_velocity
        if robot.base.drive == "omnidirectional":
            scale = min(1.0, robot.base.max_velocity / max(np.hypot(*wanted[:2]), 1e-9))
            np.testing.assert_allclose([forward, left], wanted[:2] * scale, atol=1e-12)
        else:
            np.testing.assert_allclose(forward, wanted[0], atol=1e-12)
            assert left == 0.0
        assert turn == action[0, -1] * robot.base.max_rotation


def test_the_arm_is_sent_by_the_robots_own_names(pr2):
    names = {"r_elbow_flex_joint": "elbow"}
    positions = dict(joints_at(pr2).positions)
    positions["elbow"] = positions.pop("r_elbow_flex_joint")

    def answer(readings):
        readings.base(BaseReading(0.0, 0.0, 0.0))
        readings.joints(JointReading(positions))

    link = MemoryLink(answer)
    backend = LinkBackend(pr2, link, names=names, seconds=0.25)
    state = backend.reset(None, None)
    np.testing.assert_array_equal(state.joint_positions[0], pr2.home["home"])
    backend.step(*still(pr2), DT)
    sent, seconds = link.moved[-1]
    assert list(sent) == list(robot_names(pr2, names).values())
    np.testing.assert_allclose(list(sent.values()), pr2.home["home"])
    assert seconds == 0.25


@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_continuous_joints_go_the_short_way(pr2, turns):
    backend, link = connected(pr2)
    measured = 3.0 + turns * 2.0 * np.pi
    link.readings.joints(JointReading({"r_forearm_roll_joint": measured}))
    targets = pr2.home["home"].copy()
    targets[[joint.name for joint in pr2.arm].index("r_forearm_roll_joint")] = -3.0
    backend.step(np.zeros((1, 6)), targets[np.newaxis], DT)
    sent = link.moved[-1][0]["r_forearm_roll_joint"]
    assert sent == pytest.approx(measured + 2.0 * np.pi - 6.0)


def test_step_returns_the_newest(pr2):
    backend, link = connected(pr2)
    threading.Timer(0.02, link.readings.base, [BaseReading(9.0, 0.0, 0.0)]).start()
    state = backend.step(*still(pr2), DT)
    assert state.base_pose[0, 0] == 1.0
    for _ in range(2):
        state = backend.step(*still(pr2), 0.05)
    assert state.base_pose[0, 0] == 9.0


def test_keeps_time(pr2):
    backend, _ = connected(pr2)
    for _ in range(11):
        backend.step(*still(pr2), 0.01)
    timing = backend.rate.timing()
    assert timing.periods == 11
    assert timing.p50 == pytest.approx(0.01, abs=0.004)


def test_stop_commands_zero_and_holds_the_arm(pr2):
    backend, link = connected(pr2)
    link.readings.joints(JointReading({"r_elbow_flex_joint": -1.25, "r_forearm_roll_joint": 9.0}))
    for _ in range(2):
        backend.stop()
        np.testing.assert_array_equal(link.driven[-1], np.zeros(3))
        held = link.moved[-1][0]
        assert held["r_elbow_flex_joint"] == -1.25
        assert held["r_forearm_roll_joint"] == pytest.approx(9.0)


@pytest.mark.parametrize("part", ["twist", "joints"])
def test_what_is_not_finite_is_never_sent(pr2, part):
    backend, link = connected(pr2)
    twist, joints = still(pr2)
    (twist if part == "twist" else joints.copy())[0, 0] = np.nan
    joints = joints if part == "twist" else np.full_like(joints, np.nan)
    with pytest.raises(Fault, match="must be finite"):
        backend.step(twist, joints, DT)
    np.testing.assert_array_equal(link.driven, [np.zeros(3)])


@pytest.mark.parametrize("reading", ["base", "joints"])
def test_what_arrives_between_reading_and_sending_makes_no_command(pr2, reading):
    backend, link = connected(pr2)
    if reading == "base":
        link.readings.base(BaseReading(0.0, 0.0, np.nan))
    else:
        link.readings.joints(JointReading({"r_forearm_roll_joint": np.nan}))
    with pytest.raises(Fault, match="is not finite"):
        backend.step(np.full((1, 6), 0.1), still(pr2)[1], DT)
    np.testing.assert_array_equal(link.driven, [np.zeros(3)])
    for positions, _ in link.moved:
        np.testing.assert_allclose(list(positions.values()), pr2.home["home"])


def test_an_arm_with_a_long_way_is_given_the_time_for_it(pr2):
    backend, link = connected(pr2)
    joint = [joint.name for joint in pr2.arm].index("r_elbow_flex_joint")
    targets = still(pr2)[1]
    targets[0, joint] += 1.0
    backend.step(np.zeros((1, 6)), targets, DT)
    assert link.moved[-1][1] == pytest.approx(1.0 / pr2.max_joint_velocity[joint])


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_an_arm_that_lags_is_sent_no_faster_than_the_guards_allow(pr2, share):
    link, joint = MemoryLink(present(pr2)), 3
    guard = CommandGuard(LinkBackend(pr2, link), pr2, Guards(joint_speed=share))
    home = guard.reset(*still(pr2)).joint_positions[0]
    target, speeds = still(pr2)[1], []
    target[0, joint] += 1.0
    for _ in range(30):
        link.answer(link.readings)
        guard.step(np.zeros((1, 6)), target, 0.02)
        positions, seconds = link.moved[-1]
        way = np.abs(np.array(list(positions.values())) - home)
        speeds.append(way[joint] / seconds / pr2.max_joint_velocity[joint])
    assert max(speeds) == pytest.approx(share)


def test_no_limit_is_above_what_the_robot_can(pr2):
    backend, link = connected(pr2)
    backend.limit_arm(np.full(len(pr2.arm), 99.0))
    targets = still(pr2)[1]
    targets[0, 3] += 1.0
    backend.step(np.zeros((1, 6)), targets, DT)
    assert link.moved[-1][1] == pytest.approx(1.0 / pr2.max_joint_velocity[3])


def test_what_follows_from_an_old_measurement_is_never_sent(pr2):
    backend, link = connected(pr2)
    time.sleep(0.21)
    with pytest.raises(Fault, match=r"the command comes 0\.2\d s after the measurement"):
        backend.step(np.full((1, 6), 0.1), still(pr2)[1], DT)
    np.testing.assert_array_equal(link.driven, [np.zeros(3)])
    # A period may be longer than that.
    backend.read()
    time.sleep(0.21)
    backend.step(np.full((1, 6), 0.1), still(pr2)[1], 0.4)
    assert link.driven[-1].any()


def test_what_was_held_up_while_it_was_sent_is_taken_back_at_once(pr2, monkeypatch):
    backend, link = connected(pr2)
    sent = link.drive
    monkeypatch.setattr(link, "drive", lambda velocity: (sent(velocity), time.sleep(0.21)))
    away = still(pr2)[1] + 0.1
    with pytest.raises(Fault, match="the command comes"):
        backend.step(np.full((1, 6), 0.1), away, 0.1)
    assert [bool(velocity.any()) for velocity in link.driven] == [True, False]
    # The arm was never sent away, only told to stay.
    held = [list(positions.values()) for positions, _ in link.moved]
    np.testing.assert_allclose(held, still(pr2)[1])


def test_a_broken_link_stops_the_base(pr2):
    backend, link = connected(pr2)
    backend.step(np.full((1, 6), 0.1), still(pr2)[1], DT)
    link.broken = "the cable is out"
    with pytest.raises(Fault, match="the cable is out"):
        backend.step(np.full((1, 6), 0.1), still(pr2)[1], DT)
    np.testing.assert_array_equal(link.driven[-1], np.zeros(3))
    assert len(link.driven) == 2


def test_a_clock_set_back_stops_the_base(pr2):
    backend, link = connected(pr2)
    for stamp in (100.0, 50.0):
        link.readings.base(BaseReading(0.0, 0.0, 0.0, stamp=stamp))
    with pytest.raises(Fault, match=r"the stamps of the base went back by 50\.00 s"):
        backend.read()
    np.testing.assert_array_equal(link.driven, [np.zeros(3)])


def test_silence_shows_as_age(pr2):
    backend, _ = connected(pr2)
    backend.step(*still(pr2), 0.1)
    assert backend.step(*still(pr2), 0.1).age[0] >= 0.1


def test_grips_when_asked(pr2):
    backend, link = connected(pr2)
    backend.grip("close", np.array([], dtype=np.intp))
    backend.grip("open", np.array([0]))
    assert link.gripped == ["open"]


def test_stops_and_lets_go_once(pr2):
    backend, link = connected(pr2)
    backend.close()
    backend.close()
    assert link.closed == 1
    assert len(link.driven) == 1
    backend.stop()
    assert len(link.driven) == 1


def test_refuses_what_it_cannot_do(pr2):
    backend, link = connected(pr2)
    with pytest.raises(KinfeasError, match="leads to one robot of 7 arm joints"):
        backend.step(np.zeros((2, 6)), np.zeros((2, 7)), DT)
    with pytest.raises(KinfeasError, match="seconds must be above 0 s and finite, not 0"):
        LinkBackend(pr2, link, seconds=0.0)
    with pytest.raises(KinfeasError, match="patience must be above 0 s and finite, not nan"):
        LinkBackend(pr2, link, patience=np.nan)
    with pytest.raises(KinfeasError, match="stale must be above 0 s and finite, not -1"):
        LinkBackend(pr2, link, stale=-1.0)
    with pytest.raises(KinfeasError, match="no arm joint 'elbow' to rename; known are r_"):
        LinkBackend(pr2, link, names={"elbow": "e"})
    with pytest.raises(KinfeasError, match="has not been measured yet"):
        LinkBackend(pr2, link).read()
    assert LinkBackend(pr2, link).stop() is None


@pytest.mark.parametrize("arm_fails", [False, True])
def test_an_arm_is_told_to_hold_even_if_the_base_cannot_be_stopped(pr2, monkeypatch, arm_fails):
    backend, link = connected(pr2)
    move = link.move

    def lost(velocity):
        raise Fault("the base is lost")

    def moved(positions, seconds):
        move(positions, seconds)
        if arm_fails:
            raise KeyError("arm")

    monkeypatch.setattr(link, "drive", lost)
    monkeypatch.setattr(link, "move", moved)
    with pytest.raises(Fault, match="the base is lost"):
        backend.stop()
    assert len(link.moved) == 1
