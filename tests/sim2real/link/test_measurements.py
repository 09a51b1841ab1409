import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.link import BaseReading, JointReading
from kinfeas.sim2real.link.measurements import DRIFT, Inbox, TransportDelay
from tests.sim2real.conftest import joints_at

PR2 = load_robot("pr2")
ARM = [joint.name for joint in PR2.arm]


def ages(delays, offset=0.0, rate=1.0, every=0.02, drift=DRIFT):
    """Return the estimated ages of messages at their arrival, after the given delays."""
    delay, estimates = TransportDelay(drift), []
    for number, late in enumerate(delays):
        sent = 100.0 + every * number
        estimates.append(sent + late - delay.sent(offset + rate * sent, sent + late))
    return np.array(estimates)


@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30), st.sampled_from([-1e5, 0.0, 1.7e9]))
def test_an_age_is_the_delay_beyond_the_least_one(delays, offset):
    least = np.minimum.accumulate(delays)
    np.testing.assert_allclose(
        ages(delays, offset), np.array(delays) - least, atol=DRIFT * 0.02 * len(delays) + 1e-6
    )


@pytest.mark.parametrize(
    ("rate", "drift"), [(1 - 0.9 * DRIFT, DRIFT), (1.5, DRIFT), (0.2, 0.8), (0.6, 0.8)]
)
def test_a_clock_that_drifts_within_its_bound_makes_nothing_old(rate, drift):
    np.testing.assert_allclose(ages(np.zeros(10_000), rate=rate, drift=drift), 0.0, atol=1e-9)


def test_a_queue_that_falls_behind_and_a_clock_that_is_too_slow_show_as_age():
    behind = 0.005 * 0.02 * np.arange(3_000)  # by five in a thousand
    assert 0.2 < ages(behind)[-1] < behind[-1]
    assert ages(np.zeros(1000), rate=0.1, drift=0.8)[-1] > 5.0


def test_a_stamp_that_is_repeated_ages_and_one_that_jumps_ahead_does_not():
    delay = TransportDelay()
    assert [delay.sent(5.0, arrival) for arrival in (100.0, 101.0, 150.0)] == [100.0] * 3
    assert delay.sent(1e6, 151.0) == 151.0
    assert delay.sent(1e6 + 1.0, 152.5) == pytest.approx(152.0, abs=0.01)


@pytest.fixture
def inbox(time):
    return Inbox(PR2, {joint.name: joint.name for joint in PR2.arm}, now=time.clock.monotonic)


def test_parts_come_in_any_order_and_the_newest_of_each_counts(inbox):
    readings, positions = inbox.readings(), joints_at(PR2).positions
    assert inbox.missing() == (True, ARM)
    readings.base(BaseReading(1.0, 2.0, 0.5))
    for name in sorted(positions, reverse=True):
        assert any(inbox.missing()) or name not in ARM
        readings.joints(JointReading({name: positions[name]}))
    assert not any(inbox.missing())
    readings.joints(JointReading({ARM[0]: 0.125, "unknown_joint": 3.0}))
    state = inbox.state()
    np.testing.assert_array_equal(state.joint_positions[0], [0.125, *PR2.home["home"][1:]])
    np.testing.assert_allclose(state.base_pose[0, :2], [1.0, 2.0])
    assert state.base_twist is None
    assert state.joint_velocities is None
    assert inbox.positions()["unknown_joint"] == 3.0
    # Velocities turn with the base; continuous joints are wrapped, and their turns kept.
    readings.base(BaseReading(0.0, 0.0, np.pi / 2, np.array([0.2, 0.1, 0.3])))
    speeds = {name: 0.1 * i for i, name in enumerate(ARM)}
    readings.joints(JointReading(joints_at(PR2, r_forearm_roll_joint=7.0).positions, speeds))
    state, roll = inbox.state(), ARM.index("r_forearm_roll_joint")
    np.testing.assert_allclose(state.base_twist, [[-0.1, 0.2, 0.0, 0.0, 0.0, 0.3]], atol=1e-12)
    np.testing.assert_allclose(state.joint_velocities[0], list(speeds.values()))
    assert state.joint_positions[0, roll] == pytest.approx(7.0 - 2.0 * np.pi)
    assert inbox.arm[roll] == 7.0
    inbox.forget()
    assert inbox.missing() == (True, ARM)


def test_the_age_is_that_of_the_oldest_part(inbox, time):
    readings = inbox.readings()
    readings.joints(joints_at(PR2))
    time.passes(0.5)
    readings.base(BaseReading(0.0, 0.0, 0.0))
    readings.joints(JointReading(dict.fromkeys(ARM[1:], 0.0)))
    assert inbox.state().age[0] == pytest.approx(0.5)
    readings.joints(joints_at(PR2))
    assert inbox.state().age[0] == 0.0
    readings.base(BaseReading(0.0, 0.0, 0.0, age=3.0))
    assert inbox.state().age[0] == 3.0


def test_messages_that_were_overtaken_are_dropped_and_clocks_that_are_set_back_are_faults(inbox):
    readings = inbox.readings()
    readings.joints(JointReading(joints_at(PR2).positions, stamp=9.0))
    for x, stamp in ((1.0, 10.0), (2.0, 10.0), (3.0, 9.95)):
        readings.base(BaseReading(x, 0.0, 0.0, stamp=stamp))
        readings.joints(JointReading({"r_elbow_flex_joint": -x}, stamp=stamp))
    state = inbox.state()
    assert (state.base_pose[0, 0], state.joint_positions[0, 3]) == (2.0, -2.0)
    assert inbox.fault is None
    readings.base(BaseReading(0.0, 0.0, 0.0, stamp=7.5))
    assert "the base" in inbox.fault
    inbox.forget()
    assert inbox.fault is None
    for stamp in (10.0, 7.5):
        readings.joints(JointReading({"r_elbow_flex_joint": 0.0}, stamp=stamp))
    assert "r_elbow_flex_joint" in inbox.fault


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_faults_and_dropped(inbox, bad):
    readings = inbox.readings()
    readings.base(BaseReading(1.0, 2.0, 0.5))
    readings.joints(joints_at(PR2))
    for wrong in ({"y": bad}, {"age": bad}, {"stamp": bad}):
        inbox.fault = None
        readings.base(BaseReading(**{"x": 0.0, "y": 0.0, "yaw": 0.0, **wrong}))
        assert "base" in inbox.fault
    np.testing.assert_allclose(inbox.state().base_pose[0, :2], [1.0, 2.0])
    inbox.fault = None
    readings.joints(JointReading({"a_wheel": bad}))
    assert inbox.fault is None
    readings.joints(JointReading({"r_elbow_flex_joint": bad}))
    assert "r_elbow_flex_joint" in inbox.fault
    np.testing.assert_array_equal(inbox.state().joint_positions[0], PR2.home["home"])
