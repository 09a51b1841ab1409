import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.core.errors import KinfeasError
from kinfeas.plugins.limits import norm, positive, slowed


@given(st.integers(0, 2**32 - 1), st.floats(-9.0, 9.0))
def test_slowed_twists_keep_both_limits_and_waste_neither(seed, decade):
    twist = np.random.default_rng(seed).normal(size=(5, 6)) * 10.0**decade
    share = slowed(twist, 0.1, 0.3)
    kept = twist * share[:, np.newaxis]
    linear, angular = norm(kept[:, :3]), norm(kept[:, 3:])
    assert np.all(linear <= 0.1 * (1.0 + 1e-12))
    assert np.all(angular <= 0.3 * (1.0 + 1e-12))
    full = np.maximum(linear / 0.1, angular / 0.3) >= 1.0 - 1e-12
    assert np.all(full | (share == 1.0))


def test_standing_still_is_within_limits():
    assert np.array_equal(slowed(np.zeros((2, 6)), 0.1, 0.1), [1.0, 1.0])


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan, 1e300, 1e-300, "1", None, True])
def test_refuses_what_is_not_positive(value):
    with pytest.raises(KinfeasError, match=r"^gain must be a positive number, not .*: 1e-09 to 1e"):
        positive("gain", value)
