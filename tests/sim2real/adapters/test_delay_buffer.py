import numpy as np
import pytest

from kinfeas.sim2real.adapters.delay_buffer import (
    around,
    filled,
    in_force,
    mixed,
    pushed,
    slots_for,
)

STRAIGHT = np.zeros(1, dtype=bool)


def row(*values):
    return np.array([values], dtype=float)


def test_a_line_keeps_the_newest():
    line = filled(np.array([[1.0]]), 1)
    for value in (2.0, 3.0, 4.0):
        line = pushed(line, np.array([[value]]), 3)
    np.testing.assert_array_equal(line[0, :, 0], [2.0, 3.0, 4.0])


@pytest.mark.parametrize("dt", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("seconds", [0.0, 0.019, 0.06, 0.25])
def test_a_line_is_long_enough(seconds, dt):
    assert (slots_for(seconds, dt) - 1) * dt >= seconds


def test_shares_are_those_of_time():
    arrivals = row(-np.inf, 0.96, 1.03, 1.06)
    np.testing.assert_allclose(in_force(arrivals, np.array([1.0]), 0.1), row(0, 0.3, 0.3, 0.4))


def test_a_command_that_was_overtaken_is_never_in_force():
    arrivals = row(-np.inf, 1.05, 1.02)
    np.testing.assert_allclose(in_force(arrivals, np.array([1.0]), 0.1), row(0.2, 0.0, 0.8))


def test_rounding_makes_no_fraction():
    now = np.array([sum([0.02] * 50)])
    shares = in_force(row(-np.inf, *(now - 0.04 + 0.06), *(now + 0.06)), now, 0.02)
    np.testing.assert_array_equal(shares, row(1, 0, 0))


def test_means_are_to_the_bit_where_there_is_one_and_short_for_angles():
    line = np.array([[[0.1], [3.0], [-3.0]]])
    np.testing.assert_array_equal(mixed(line, row(0, 1, 0), STRAIGHT), [[3.0]])
    np.testing.assert_allclose(mixed(line, row(0, 0.5, 0.5), STRAIGHT), [[0.0]], atol=1e-15)
    np.testing.assert_allclose(mixed(line, row(0, 0.5, 0.5), ~STRAIGHT), [[np.pi]])


@pytest.mark.parametrize(
    ("moment", "expected"),
    [(0.0, (1, 0.0)), (0.05, (1, 0.5)), (0.1, (2, 0.0)), (0.1 - 1e-12, (2, 0.0)), (0.2, (3, 0.0))],
)
def test_finds_what_a_moment_lies_between(moment, expected):
    times = row(-np.inf, 0.0, 0.1, 0.2)
    index, share = around(times, np.array([moment]))
    assert (index[0], share[0]) == (expected[0], pytest.approx(expected[1]))
