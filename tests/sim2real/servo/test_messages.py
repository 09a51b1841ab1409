import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.sim2real.servo.messages import SenderClock

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
