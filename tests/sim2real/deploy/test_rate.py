import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.deploy.rate import Rate


class Clock:
    """Time that passes when somebody sleeps or works; whoever sleeps wakes up a little late."""

    def __init__(self, late=0.0):
        self.time, self.late, self.slept = 100.0, late, 0

    def now(self):
        return self.time

    def sleep(self, seconds):
        assert seconds > 0.0
        self.slept += 1
        self.time += seconds + self.late


def started(clock, dt=0.02):
    metronome = Rate(dt, now=clock.now, sleep=clock.sleep)
    assert metronome.wait() == 0.0
    return metronome


def test_late_awakenings_do_not_add_up():
    clock = Clock(late=0.001)
    metronome = started(clock)
    for _ in range(1000):
        clock.time += 0.005
        metronome.wait()
    assert clock.time == pytest.approx(100.0 + 1000 * 0.02 + 0.001, abs=1e-6)
    timing = metronome.timing()
    assert (timing.periods, timing.misses) == (1000, 0)
    assert timing.p50 == pytest.approx(0.02)
    assert timing.work_p50 == pytest.approx(0.005)
    assert timing.work_p99 == pytest.approx(0.005)


def test_a_late_period_is_counted_and_does_not_shift_the_next():
    clock = Clock()
    metronome = started(clock)
    clock.time += 0.025
    assert metronome.wait() == pytest.approx(0.025)
    assert metronome.wait() == pytest.approx(0.015)
    assert metronome.timing().misses == 1


def test_deadlines_that_have_passed_are_left_out():
    clock = Clock()
    metronome = started(clock)
    clock.time += 0.09
    metronome.wait()
    periods = [metronome.wait() for _ in range(3)]
    np.testing.assert_allclose(periods, [0.01, 0.02, 0.02], atol=1e-9)
    assert metronome.timing().misses == 1


def test_measures_what_another_waits_for():
    clock = Clock()
    metronome = Rate(0.02, now=clock.now)
    assert metronome.tick() == 0.0
    for period in (0.02, 0.029, 0.031, 0.019):
        clock.time += period
        assert metronome.tick() == pytest.approx(period)
    timing = metronome.timing()
    assert (timing.periods, timing.misses) == (4, 1)
    assert timing.longest == pytest.approx(0.031)
    assert timing.work_p50 is None


def test_nothing_measured_is_no_error():
    assert Rate(0.02).timing().periods == 0


def test_keeps_the_clock_on_the_wall():
    metronome = Rate(0.005)
    metronome.wait()
    assert sum(metronome.wait() for _ in range(20)) == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_refuses_other_periods(dt):
    with pytest.raises(KinfeasError, match="control period"):
        Rate(dt)
