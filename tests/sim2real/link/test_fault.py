import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.sim2real.link.fault import beyond


@pytest.mark.parametrize(
    ("value", "limit", "shown"),
    [
        (0.5, 0.2, "0.50"),
        (0.0123, 0.01, "0.012"),
        (20.0, 1.0, "20.00"),
        (20.0004, 20.0, "20.0004"),
        (1e-9, 0.0, "0.000000001"),
        (math.inf, 1.0, "inf"),
        (math.nan, 1.0, "nan"),
    ],
)
def test_two_decimals_or_as_many_as_are_needed(value, limit, shown):
    assert beyond(value, limit) == shown


@given(st.floats(0.001, 1e5), st.floats(1e-6, 1.0))
def test_what_is_shown_is_above_the_limit(limit, more):
    assert float(beyond(limit + more, limit)) > limit
