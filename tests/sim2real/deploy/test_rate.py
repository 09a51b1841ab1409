import numpy as np
import pytest

from kinfeas.sim2real.deploy.rate import Clock, Rate


@pytest.fixture
def rate(time):
    started = Rate(0.02, time.clock)
    assert started.wait() == 0.0
    return started


def test_late_awakenings_do_not_add_up(time):
    clock = Clock(lambda: time.monotonic, sleep=lambda seconds: time.passes(seconds + 0.001))
    rate = Rate(0.02, clock)
    rate.wait()
    for _ in range(1000):
        time.passes(0.005)
        rate.wait()
    assert time.monotonic == pytest.approx(1000.0 + 1000 * 0.02 + 0.001, abs=1e-6)
    timing = rate.timing()
    assert (timing.periods, timing.misses) == (1000, 0)
    assert timing.p50 == pytest.approx(0.02)
    assert (timing.work_p50, timing.work_p99) == (pytest.approx(0.005), pytest.approx(0.005))


@pytest.mark.parametrize(
    ("late", "periods"), [(0.025, [0.025, 0.015, 0.02]), (0.09, [0.09, 0.01, 0.02])]
)
def test_a_late_period_is_counted_and_shifts_no_deadline(rate, time, late, periods):
    time.passes(late)
    np.testing.assert_allclose([rate.wait() for _ in range(3)], periods, atol=1e-9)
    assert rate.timing().misses == 1


def test_measures_periods_that_a_robot_times(time):
    rate = Rate(0.02, time.clock)
    assert rate.tick() == 0.0
    assert rate.timing().periods == 0
    for period in (0.02, 0.029, 0.031, 0.019):
        time.passes(period)
        assert rate.tick() == pytest.approx(period)
    timing = rate.timing()
    assert (timing.periods, timing.misses, timing.work_p50) == (4, 1, None)
    assert timing.longest == pytest.approx(0.031)
