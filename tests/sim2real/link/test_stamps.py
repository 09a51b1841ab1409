import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.sim2real.link.stamps import DRIFT, Stamps


def ages(delays, ahead=0.0, rate=1.0, every=0.02, drift=DRIFT):
    """Return how old messages seem at their arrival that were on their way for so long."""
    stamps, seen = Stamps(drift), []
    for number, delay in enumerate(delays):
        sent = 100.0 + every * number
        arrival = sent + delay
        seen.append(arrival - stamps.since(ahead + rate * sent, arrival))
    return np.array(seen)


@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30), st.sampled_from([-1e5, 0.0, 1.7e9]))
def test_what_is_longer_on_its_way_than_others_is_as_much_older(delays, ahead):
    least = np.minimum.accumulate(delays)
    np.testing.assert_allclose(
        ages(delays, ahead), np.array(delays) - least, atol=DRIFT * 0.02 * len(delays) + 1e-6
    )


def test_what_is_constant_between_the_clocks_is_not_seen():
    np.testing.assert_allclose(ages(np.full(10, 0.3), ahead=-50.0), 0.0, atol=1e-9)


@pytest.mark.parametrize("rate", [1.0 - 0.9 * DRIFT, 1.0 + 0.9 * DRIFT, 1.5])
def test_a_clock_that_drifts_makes_nothing_old(rate):
    np.testing.assert_allclose(ages(np.zeros(100_000), rate=rate), 0.0, atol=1e-9)


@pytest.mark.parametrize("rate", [0.2, 0.6, 1.0])
def test_a_simulator_may_be_as_much_slower_as_is_said(rate):
    np.testing.assert_allclose(ages(np.zeros(1000), rate=rate, drift=0.8), 0.0, atol=1e-9)
    assert ages(np.zeros(1000), rate=0.1, drift=0.8)[-1] > 5.0


def test_a_queue_that_falls_behind_is_seen_before_it_matters():
    behind = 0.005 * 0.02 * np.arange(3_000)  # by five in a thousand
    assert 0.2 < ages(behind)[-1] < behind[-1]


def test_a_burst_after_a_gap_is_old_until_it_has_caught_up():
    delays = [0.0, *np.arange(2.0, 0.0, -0.02), 0.0]
    np.testing.assert_allclose(ages(delays), delays, atol=0.01)


def test_what_is_sent_again_grows_old():
    stamps = Stamps()
    assert [stamps.since(5.0, arrival) for arrival in (100.0, 101.0, 150.0)] == [100.0] * 3


def test_a_clock_that_jumps_ahead_begins_anew():
    stamps = Stamps()
    stamps.since(5.0, 100.0)
    assert stamps.since(1e6, 101.0) == 101.0
    assert stamps.since(1e6 + 1.0, 102.5) == pytest.approx(102.0, abs=0.01)
