import time

import numpy as np
import pytest

from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.link.backend import robot_names
from kinfeas.sim2real.link.inbox import Inbox
from tests.sim2real.links import joints_at


@pytest.fixture(scope="module")
def pr2():
    return load_robot("pr2")


@pytest.fixture
def inbox(pr2):
    return Inbox(pr2, robot_names(pr2, {}))


def test_parts_come_in_any_order_and_any_pieces(pr2, inbox):
    readings, positions = inbox.readings(), joints_at(pr2).positions
    readings.base(BaseReading(1.0, 2.0, 0.5))
    for name in sorted(positions, reverse=True):
        assert not (inbox.wait(0.0) and name in inbox.lacks()[1])
        readings.joints(JointReading({name: positions[name]}))
    assert inbox.wait(0.0)
    state = inbox.state()
    np.testing.assert_array_equal(state.joint_positions[0], pr2.home["home"])
    np.testing.assert_allclose(state.base_pose[0, :2], [1.0, 2.0])
    assert state.base_twist is None
    assert state.joint_velocities is None


def test_the_newest_of_each_part_counts(pr2, inbox):
    readings, first = inbox.readings(), pr2.arm[0].name
    readings.base(BaseReading(0.0, 0.0, 0.0))
    readings.joints(joints_at(pr2))
    readings.joints(JointReading({first: 0.125, "unheard_of_joint": 3.0}))
    home = pr2.home["home"]
    np.testing.assert_array_equal(inbox.state().joint_positions[0], [0.125, *home[1:]])
    assert inbox.heard()["unheard_of_joint"] == 3.0


def test_velocities_are_told_in_the_world(pr2, inbox):
    readings = inbox.readings()
    readings.base(BaseReading(0.0, 0.0, np.pi / 2, np.array([0.2, 0.1, 0.3])))
    speeds = {joint.name: 0.1 * i for i, joint in enumerate(pr2.arm)}
    readings.joints(JointReading(joints_at(pr2).positions, speeds))
    state = inbox.state()
    np.testing.assert_allclose(state.base_twist, [[-0.1, 0.2, 0.0, 0.0, 0.0, 0.3]], atol=1e-12)
    np.testing.assert_allclose(state.joint_velocities[0], list(speeds.values()))


def test_continuous_joints_are_wrapped_and_their_turns_kept(pr2, inbox):
    readings = inbox.readings()
    readings.base(BaseReading(0.0, 0.0, 0.0))
    readings.joints(joints_at(pr2, r_forearm_roll_joint=7.0))
    number = [joint.name for joint in pr2.arm].index("r_forearm_roll_joint")
    assert inbox.state().joint_positions[0, number] == pytest.approx(7.0 - 2.0 * np.pi)
    assert inbox.raw()[number] == 7.0


def test_the_age_is_that_of_the_oldest_part(pr2, inbox):
    readings = inbox.readings()
    readings.joints(joints_at(pr2))
    time.sleep(0.05)
    readings.base(BaseReading(0.0, 0.0, 0.0))
    for joint in pr2.arm[1:]:
        readings.joints(JointReading({joint.name: 0.0}))
    assert inbox.state().age[0] >= 0.05
    readings.joints(joints_at(pr2))
    assert inbox.state().age[0] < 0.05
    readings.base(BaseReading(0.0, 0.0, 0.0, age=3.0))
    assert inbox.state().age[0] >= 3.0


def test_stamps_say_nothing_about_ages(pr2, inbox):
    readings = inbox.readings()
    for stamp in (5.0, 1e9):
        readings.base(BaseReading(0.0, 0.0, 0.0, stamp=stamp))
        readings.joints(JointReading(joints_at(pr2).positions, stamp=stamp))
        assert 0.0 <= inbox.state().age[0] < 1.0
    assert inbox.fault is None


def test_what_was_overtaken_is_dropped(pr2, inbox):
    readings = inbox.readings()
    readings.joints(joints_at(pr2))
    for x, stamp in ((1.0, 10.0), (2.0, 10.0), (3.0, 9.95)):
        readings.base(BaseReading(x, 0.0, 0.0, stamp=stamp))
    assert inbox.state().base_pose[0, 0] == 2.0
    assert inbox.fault is None


def test_what_is_repeated_is_not_new(pr2, inbox, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    readings = inbox.readings()
    for _ in range(5):
        readings.base(BaseReading(0.0, 0.0, 0.0, stamp=10.0))
        readings.joints(JointReading(joints_at(pr2).positions, stamp=10.0))
        now[0] += 0.1
    assert inbox.state().age[0] == pytest.approx(0.5)
    readings.base(BaseReading(0.0, 0.0, 0.0, stamp=10.5))
    readings.joints(JointReading(joints_at(pr2).positions, stamp=10.5))
    assert inbox.state().age[0] == 0.0
    readings.base(BaseReading(0.0, 0.0, 0.0))
    readings.joints(joints_at(pr2))
    assert inbox.state().age[0] == 0.0


def test_a_queue_that_falls_behind_shows_as_age(pr2, inbox, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    readings, positions = inbox.readings(), joints_at(pr2).positions
    for number in range(1, 101):  # sent at 50 Hz, taken out at 45 Hz
        now[0] = 100.0 + number / 45.0
        readings.base(BaseReading(0.0, 0.0, 0.0, stamp=7.0 + 0.02 * number))
        readings.joints(JointReading(positions, stamp=7.0 + 0.02 * number))
    assert inbox.state().age[0] == pytest.approx(99 / 45.0 - 0.02 * 99, rel=0.02)


def test_a_reading_that_was_old_before_it_was_stamped_stays_so(pr2, inbox, monkeypatch):
    monkeypatch.setattr("time.monotonic", lambda: 100.0)
    inbox.readings().joints(joints_at(pr2))
    for age in (0.0, 0.3):
        inbox.readings().base(BaseReading(0.0, 0.0, 0.0, stamp=7.0, age=age))
        assert inbox.state().age[0] == pytest.approx(age)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_stamp_that_is_not_finite_is_a_fault(pr2, inbox, bad):
    inbox.readings().base(BaseReading(0.0, 0.0, 0.0, stamp=bad))
    assert inbox.fault == "a stamp of the base is not finite"
    assert inbox.lacks()[0]


def test_stamps_of_different_joints_are_not_compared(pr2, inbox):
    readings = inbox.readings()
    first, second = (joint.name for joint in pr2.arm[:2])
    readings.joints(JointReading({first: 0.1}, stamp=10.0))
    readings.joints(JointReading({second: 0.2}, stamp=5.0))
    assert inbox.fault is None
    assert inbox.heard() == {first: 0.1, second: 0.2}


@pytest.mark.parametrize("part", ["the base", "r_elbow_flex_joint"])
def test_a_clock_that_goes_backwards_is_a_fault(inbox, part):
    readings = inbox.readings()
    for stamp in (10.0, 7.5):
        if part == "the base":
            readings.base(BaseReading(0.0, 0.0, 0.0, stamp=stamp))
        else:
            readings.joints(JointReading({part: 0.0}, stamp=stamp))
    assert f"the stamps of {part} went back by 2.50 s" in inbox.fault
    inbox.forget()
    assert inbox.fault is None


def test_forgets_everything(pr2, inbox):
    inbox.readings().base(BaseReading(0.0, 0.0, 0.0))
    inbox.readings().joints(joints_at(pr2))
    assert inbox.lacks() == (False, [])
    inbox.forget()
    assert inbox.lacks() == (True, [joint.name for joint in pr2.arm])
    assert not inbox.wait(0.01)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_a_fault_and_not_taken(pr2, inbox, bad):
    readings = inbox.readings()
    readings.base(BaseReading(1.0, 2.0, 0.5))
    readings.joints(joints_at(pr2))
    for reading in (BaseReading(0.0, bad, 0.0), BaseReading(0.0, 0.0, 0.0, age=bad)):
        readings.base(reading)
        assert inbox.fault == "the measured base pose is not finite"
    np.testing.assert_allclose(inbox.state().base_pose[0, :2], [1.0, 2.0])
    inbox.fault = None
    readings.joints(JointReading({"a_wheel": bad, "r_elbow_flex_joint": bad}))
    assert inbox.fault == "the measured position of joint r_elbow_flex_joint is not finite"
    np.testing.assert_array_equal(inbox.raw(), pr2.home["home"])
