import numpy as np
import pytest

from kinfeas.core.solids import Solids
from kinfeas.kinematics.free_space import connected

START, BEYOND, BESIDE = np.zeros(2), [3.0, 0.0], [0.0, 3.0]


def fence(gap):
    """Return walls around a square of 4 m, with a gap on the side towards x."""
    half, solids = (4.0 - gap) / 4.0, Solids.empty(1, 5)
    side = gap / 2.0 + half
    solids.pose[0, :, :2] = [[2, side], [2, -side], [-2, 0], [0, 2], [0, -2]]
    solids.size[0] = [*[[0.05, half, 0, 1]] * 2, [0.05, 2, 0, 1], *[[2, 0.05, 0, 1]] * 2]
    return solids


@pytest.mark.parametrize(("gap", "open_"), [(1.2, True), (0.5, False), (0.0, False)])
def test_a_disc_passes_gaps_that_are_wide_enough(gap, open_):
    places = np.array([BEYOND, BESIDE, [1.0, 1.0]])
    reached = connected(fence(gap), START, places, (0.4, 0.0))
    np.testing.assert_array_equal(reached, [open_, open_, True])


def test_solids_above_a_disc_do_not_block_it():
    solids = fence(0.0)
    solids.size[..., 2] = 0.5
    assert connected(solids, START, np.array([BEYOND]), (0.4, 0.0)).all()
