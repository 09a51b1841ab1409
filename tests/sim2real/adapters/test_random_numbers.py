import numpy as np
import pytest
from scipy.stats import kstest

from kinfeas.sim2real.adapters.random_numbers import normal, uniform


def seeds(n, first=0):
    return np.arange(first, first + n, dtype=np.uint64)


def steps(n, value=0):
    return np.full(n, value, dtype=np.uint64)


@pytest.mark.parametrize(("draw", "law"), [(normal, "norm"), (uniform, "uniform")])
def test_draws_follow_their_law_in_each_column(draw, law):
    found = draw(seeds(20_000), steps(20_000), 12)
    for column in found.T:
        assert kstest(column, law).pvalue > 1e-3
    correlations = np.corrcoef(found.T) - np.eye(12)
    assert np.abs(correlations).max() < 5.0 / np.sqrt(20_000)


@pytest.mark.parametrize("draw", [normal, uniform])
def test_rows_and_steps_are_on_their_own(draw):
    together = draw(seeds(5), steps(5, 3), 4)
    for row in range(5):
        alone = draw(seeds(1, row), steps(1, 3), 4)
        np.testing.assert_array_equal(alone[0], together[row])
    assert np.intersect1d(together, draw(seeds(5), steps(5, 4), 4)).size == 0
