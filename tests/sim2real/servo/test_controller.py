import math
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.config import PluginSpec
from kinfeas.control.assemble import assemble
from kinfeas.control.targets import TargetRules
from kinfeas.core import spatial
from kinfeas.core.errors import Fault
from kinfeas.core.start import stacked
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.servo.controller import TargetController
from kinfeas.sim2real.servo.messages import SenderClock
from kinfeas.tasks.task import build_subgoals
from tests.builders import assert_near, rngs
from tests.sim2real.conftest import Time

DT = 0.02
SOLVER = IkSolver(load_robot("pr2"))


def begin(adapters=(), **rules):
    clock = Time()
    controller = TargetController(SOLVER.robot, TargetRules(**rules), clock=clock.clock.monotonic)
    filters = [controller, PluginSpec("time_scaling")]
    loop = assemble(
        SOLVER, build_subgoals(controller.subgoals), AnalyticBackend(), dt=DT, filters=filters,
        stream=controller, adapters=adapters,
    )  # fmt: skip
    loop.start(stacked([controller.sample(SOLVER, np.random.default_rng(0))]), rngs(1))
    return controller, clock, loop


def step(clock, loop, base=0.0):
    clock.passes(DT)
    return loop.step(np.full((1, 3), base))


def speed(loop, before):
    return float(np.linalg.norm(loop.ee_pose[0, :3] - before[0, :3])) / DT


def test_the_ee_follows_twists_and_rests_within_0_3_s_after_the_last_one():
    controller, clock, loop = begin()
    for _ in range(50):
        controller.set_twist([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
        before = loop.ee_pose
        assert step(clock, loop).feasible[0]
    assert speed(loop, before) == pytest.approx(0.05, rel=1e-3)
    ended = clock.monotonic
    while clock.monotonic < ended + 0.3:
        before = loop.ee_pose
        step(clock, loop, base=0.5)
    assert speed(loop, before) < 0.002
    base = loop.robots.base_pose
    step(clock, loop, base=0.5)
    np.testing.assert_array_equal(loop.robots.base_pose, base)


def test_twists_and_poses_may_be_given_in_the_frames_of_base_and_ee():
    controller, clock, loop = begin(max_jump=1.0)
    ee, frame = loop.desired[0], SOLVER.robot.ee_frame
    for _ in range(20):
        controller.set_twist([0.05, 0.0, 0.0, 0.0, 0.0, 0.0], frame=frame)
        step(clock, loop)
    forward = spatial.rotation(ee).as_matrix()[:, 0]
    displacement = loop.desired[0, :3] - ee[:3]
    np.testing.assert_allclose(displacement / np.linalg.norm(displacement), forward, atol=1e-6)
    above = spatial.IDENTITY + np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    aim = spatial.compose(loop.desired[0], above)
    for _ in range(2):
        controller.set_target(above, frame=frame)
        step(clock, loop)
        controller.set_target(aim)
    for _ in range(60):
        controller.set_target(aim)
        step(clock, loop)
    assert spatial.distance(loop.desired[0], aim)[0] < 1e-4


def test_frames_are_where_a_late_base_is_now():
    late = PluginSpec("command_latency", {"seconds": 0.2})
    controller, clock, loop = begin((late,), max_jump=1.0)
    for _ in range(50):
        controller.set_twist([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0])
        step(clock, loop, base=1.0)
    aim, base = loop.desired[0], loop.true_state[0][0]
    controller.set_target(spatial.relative(aim, base), frame=SOLVER.robot.base.frame)
    step(clock, loop)
    np.testing.assert_allclose(loop.sequence.goal[0, :2], aim[:2], atol=1e-6)


MALFORMED = [
    None, "up", [], [1.0], [[1.0] * 6] * 2, {"x": 1}, object(), [1.0] * 8, ["a"] * 6, 10**400,
    [math.nan] * 6, [math.inf] * 7, [0.0] * 7, [1e300] * 7, np.zeros((0, 7)),
    [0.0] * 6 + [5.0], [spatial.IDENTITY] * 65,
]  # fmt: skip


def test_malformed_messages_from_many_threads_have_no_effect():
    controller, clock, loop = begin()
    begun = loop.desired.copy()

    def send():
        for value in MALFORMED:
            controller.set_twist(value)
            controller.set_target(value, frame=SOLVER.robot.base.frame)
            controller.set_target(spatial.IDENTITY, frame="nowhere")
            controller.set_target(spatial.IDENTITY, stamp="soon")
            controller.set_chunk(value, np.arange(65) / 65.0)
            controller.set_chunk([spatial.IDENTITY] * 2, value)

    threads = [threading.Thread(target=send) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for _ in range(5):
        step(clock, loop)
    np.testing.assert_array_equal(loop.desired, begun)
    assert controller.counts["accepted"] == 0
    assert controller.counts["invalid"] == 2 * 5 * len(MALFORMED)
    assert controller.counts["frame"] == 2 * len(MALFORMED)


def test_time_scaling_waits_at_the_end_of_the_reach():
    """An arm that is led out of its reach, while the base may not move, stops without a failure."""
    controller, clock, loop = begin()
    scales = []
    for _ in range(250):
        controller.set_twist([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
        outcome = step(clock, loop)
        assert outcome.feasible[0]
        assert not outcome.joint_jump[0]
        scales.append(outcome.time_scale[0])
    assert scales[0] == 1.0
    assert scales[-1] == 0.0
    controller.set_twist([0.0, 0.0, -0.2, 0.0, 0.0, 0.0])
    for _ in range(4):
        outcome = step(clock, loop)
    assert outcome.time_scale[0] == 1.0


def test_the_arm_catches_up_with_a_resting_ee_after_a_jump_of_the_localisation():
    walk, jumps = {"drift": 0.0, "turn_drift": 0.0}, {"jump": 0.08, "turn_jump": 0.05, "rate": 1}
    controller, clock, loop = begin([PluginSpec("localisation", {**walk, **jumps})])
    outcomes = []
    for _ in range(400):
        controller.set_twist(np.zeros(6))
        outcomes.append(step(clock, loop))
        assert not outcomes[-1].joint_jump[0]
    feasible = np.array([outcome.feasible[0] for outcome in outcomes])
    assert 0.8 < feasible.mean() < 1.0


def columns(poses):
    """Return poses (k, 7) with two columns of rotation matrices, neither of length one, (k, 9)."""
    matrices = spatial.rotation(poses).as_matrix()
    return np.concatenate([poses[:, :3], 1.5 * matrices[:, :, 0], matrices[:, :, 1]], axis=1)


@pytest.mark.parametrize("rotations", [lambda poses: poses, columns], ids=["quaternions", "6-D"])
def test_a_relative_chunk_begins_at_the_pose_of_its_observation(rotations):
    """It arrives 0.2 s after the observation, and the last chunk stays until 0.3 s."""
    controller, clock, loop = begin()
    begun, times = clock.monotonic, np.linspace(0.1, 2.0, 20)
    first = np.tile(loop.desired[0], (20, 1))
    first[:, 2] += 0.1 * times
    controller.set_chunk(first, begun + times)
    for _ in range(25):
        step(clock, loop)
    observed, seen = clock.monotonic, loop.desired[0]
    for _ in range(10):
        step(clock, loop)
    actions = np.tile(spatial.planar_pose(0.0, 0.0, 0.4), (20, 1))
    actions[:, :2] = np.linspace(0.0, [0.1, 0.05], 20)
    chunk = rotations(actions), observed + times
    controller.set_chunk(*chunk, relative=True, observed=observed, keep=0.3)
    while clock.monotonic < observed + 0.3 - 1.5 * DT:
        step(clock, loop)
    assert loop.desired[0, 2] > seen[2] + 0.02
    np.testing.assert_allclose(loop.desired[0, [0, 1, 3, 4, 5, 6]], seen[[0, 1, 3, 4, 5, 6]])
    for _ in range(110):
        step(clock, loop)
    assert_near(loop.desired[0], spatial.compose(seen, actions[-1]), 1e-4, 1e-3)


def test_chunks_of_wrong_times_and_rotations_are_ignored():
    controller, clock, loop = begin()
    for _ in range(300):
        step(clock, loop)
    now, chunk = clock.monotonic, np.tile(spatial.IDENTITY, (2, 1))
    times, parallel = now + np.array([0.1, 0.2]), np.tile([0.0] * 3 + [1.0, 0.0, 0.0] * 2, (2, 1))
    for poses, observed in (
        (chunk, now - 0.2), (chunk, now - 0.3), (chunk, now - 5.9), (chunk, now + 0.1),
        (chunk, math.nan), (parallel, now), (np.full((2, 9), 1e300), now), (chunk[:, :6], now),
    ):  # fmt: skip
        controller.set_chunk(poses, times, relative=True, observed=observed)
    controller.set_chunk(chunk, times, keep=math.inf)
    step(clock, loop)
    counts = {name: count for name, count in controller.counts.items() if count}
    assert counts == {"accepted": 1, "repeated": 1, "late": 1, "ahead": 1, "invalid": 5}


def test_chunks_that_end_before_the_last_one_does_are_late():
    controller, clock, loop = begin()
    chunk = np.tile(controller.pose, (2, 1)), clock.monotonic + np.array([0.1, 0.2])
    controller.set_chunk(np.empty((0, 7)), [], keep=300.0)
    controller.set_chunk(*chunk, keep=300.0)
    step(clock, loop)
    assert controller.counts["late"] == 1
    assert "'keep', 300 s" in controller.refusal


UP = [0.0, 0.0, 0.05, 0.0, 0.0, 0.0]


def test_messages_are_counted_by_the_reason_why_they_are_ignored():
    controller, clock, loop = begin()
    there = clock.monotonic
    for stamp in (0.0, 0.01, 0.01, 0.005, -0.5, 1e6):
        controller.set_twist(UP, stamp=there + stamp)
        clock.passes(0.01)
    controller.set_twist(UP, frame="nowhere")
    controller.set_twist([math.nan] * 6)
    controller.set_twist(spatial.IDENTITY)  # a pose is no twist, nor the other way round
    controller.set_target(UP)
    controller.set_chunk([UP], [clock.monotonic])
    controller.set_target(np.array([9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    step(clock, loop)
    expected = {"accepted": 2, "repeated": 2, "late": 1, "ahead": 1, "frame": 1, "invalid": 4}
    assert controller.counts == {**expected, "jump": 1, "dropped": 0}
    for _ in range(1000):
        controller.set_twist(UP)
    step(clock, loop)
    counts = controller.counts
    assert counts["dropped"] > 0
    assert sum(counts.values()) == 1012


def test_messages_that_are_ignored_for_long_are_reported_once(caplog):
    controller, clock, loop = begin()
    for count, behind in ((10, 0.0), (200, 0.3), (10, 0.0)):
        for _ in range(count):
            controller.set_twist(UP, stamp=clock.monotonic - behind)
            step(clock, loop)
    (record,) = caplog.records
    assert "late" in record.getMessage()
    controller.fail("the tracker is gone")
    with pytest.raises(Fault, match="the tracker is gone"):
        step(clock, loop)


@pytest.mark.parametrize("every", [2, 10])
def test_streams_slower_than_their_timeout_are_reported(every):
    controller, clock, loop = begin()
    for period in range(60):
        if period % every == 0:
            controller.set_twist(UP)
        step(clock, loop)
    assert ("rules.timeout" in controller.hint) is (every == 10)


@pytest.mark.parametrize(
    ("poses", "words", "reasons"),
    [
        ([[3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]], {}, ["1 jump", "0.5 m"]),
        ([spatial.IDENTITY], {"frame": "tool"}, ["1 frame", "'tool'", "base_footprint"]),
        ([np.zeros(7)], {}, ["1 invalid", "length"]),
        ([spatial.IDENTITY] * 100, {}, ["1 invalid", "100 poses"]),
        ([spatial.IDENTITY] * 3, {"times": [0.3, 0.2, 0.1]}, ["1 invalid", "ascend"]),
        ([[math.nan] * 7], {}, ["1 invalid", "finite"]),
    ],
)  # fmt: skip
def test_the_last_ignored_message_has_its_reason(poses, words, reasons):
    controller, clock, loop = begin()
    times = clock.monotonic + np.array(words.pop("times", 0.01 * np.arange(len(poses))))
    controller.set_chunk(poses, times, **words)
    step(clock, loop)
    assert all(reason in controller.refusal for reason in reasons), controller.refusal


TOLERANCE, EVERY = 0.1, 0.02


class Stream:
    """A sender at 50 Hz, with a clock of its own, and a receiver."""

    def __init__(self, ahead=0.0):
        self.clock, self.now, self.ahead = SenderClock(TOLERANCE), 1000.0, ahead

    def take(self, stamp):
        """Return whether a message that arrives now counts as fresh."""
        sent = self.clock.sent(stamp, self.now)
        assert sent is None or sent <= self.now
        return sent is not None and self.now - sent <= TOLERANCE

    def run(self, count, late=0.0, every=EVERY, rate=1.0):
        """Return which of the next messages, each late by some seconds, are fresh, (count,)."""
        fresh = []
        for _ in range(count):
            fresh.append(self.take(rate * (self.now - late) + self.ahead))
            self.now += every
        return np.array(fresh)


@pytest.mark.parametrize("ahead", [0.0, 1.7e9, -900.0])
@pytest.mark.parametrize("overtaken", [0, 1, 4, 10])
def test_messages_of_a_queue_are_late_also_behind_older_ones(ahead, overtaken):
    stream = Stream(ahead)
    assert stream.run(50).all()
    last = stream.now - EVERY
    stream.now += 5.0
    for i in range(overtaken):
        assert not stream.take(last - 0.01 * (overtaken - i) + ahead)
        stream.now += EVERY
    assert not stream.run(250, late=stream.now - last - EVERY).any()
    assert stream.run(50).all()


@given(
    st.lists(st.tuples(st.floats(0.2, 5.0), st.floats(0.0, 5.0)), min_size=1, max_size=4),
    st.lists(st.floats(0.0, 0.05), min_size=50, max_size=50),
)
def test_no_message_that_waited_longer_than_the_tolerance_is_fresh(outages, jitter):
    """Messages keep their order; those of an outage arrive after it, all at once."""
    clock, made = SenderClock(TOLERANCE), 1000.0 + EVERY * np.arange(1000)
    arrivals, begin = made + np.resize(jitter, len(made)), 1002.0
    for seconds, pause in outages:
        waits = (arrivals >= begin) & (arrivals < begin + seconds)
        arrivals[waits] = begin + seconds
        begin += seconds + pause
    arrivals = np.maximum.accumulate(arrivals)
    least = np.inf
    for stamp, arrival in zip(made, arrivals, strict=True):
        least = min(least, arrival - stamp)
        sent = clock.sent(stamp - 500.0, arrival)
        assert arrival - sent == pytest.approx(arrival - stamp - least, abs=0.03)


@pytest.mark.parametrize("error", [1e6, 5.0, 0.2, -0.2, -5.0, -1e6, 1e300, -1e300])
def test_one_wrong_stamp_costs_one_message(error):
    stream = Stream()
    assert stream.run(50).all()
    assert not stream.take(stream.now + error)
    stream.now += EVERY
    assert stream.run(3000).all()


@pytest.mark.parametrize(
    ("change", "pause"),  # the last ones are of a sender that restarts
    [(1.0, 0.0), (-1.0, 0.0), (0.3, 0.0), (-3600.0, 0.0), (-1000.0, 3.0), (5000.0, 3.0)],
)
def test_a_clock_that_is_set_is_accepted_after_half_a_second(change, pause):
    stream = Stream()
    assert stream.run(50).all()
    stream.now, stream.ahead = stream.now + pause, stream.ahead + change
    fresh = stream.run(200)
    assert pause or not fresh[:20].any()
    assert fresh[30:].all()


@pytest.mark.parametrize("behind", [0.3, -0.3])
def test_of_two_senders_the_first_is_followed(behind):
    stream, fresh = Stream(), []
    for _ in range(500):
        fresh.append((stream.take(stream.now), stream.take(stream.now - behind)))
        stream.now += EVERY
    assert [sum(column) for column in zip(*fresh, strict=True)] == [500, 0]


@pytest.mark.parametrize("rate", [1 - 1e-4, 1 + 1e-4])
def test_a_clock_may_drift_for_an_hour(rate):
    assert Stream().run(36_000, every=0.1, rate=rate).all()
