import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas.core.errors import KinfeasError
from kinfeas.core.solids import MovingSolids, Solids, stacked_solids


def row(*positions):
    """Return one row of boxes at (x, y), each half a metre wide."""
    solids = Solids.empty(1, len(positions))
    solids.pose[0, :, :2], solids.size[0] = positions, [0.25, 0.25, 0.0, 1.0]
    return solids


@given(st.floats(0.0, 1000.0), st.floats(0.01, 2.0), st.floats(0.1, 5.0))
def test_moving_solids_stay_on_their_span_and_keep_their_speed(seconds, speed, span):
    solids = row((1.0, 2.0))
    solids.velocity[0, 0], solids.span[0, 0] = [0.0, speed], span
    at = [float(solids.at(np.array([t])).pose[0, 0, 1]) for t in (seconds, seconds + 1e-3)]
    assert all(2.0 - 1e-9 <= y <= 2.0 + span + 1e-9 for y in at)
    assert abs(at[1] - at[0]) <= speed * 1e-3 + 1e-9
    period = solids.at(np.array([seconds + 2.0 * span / speed])).pose[0, 0, 1]
    np.testing.assert_allclose(period, at[0], atol=1e-6)


def test_solids_without_a_span_have_no_velocity():
    solids = row((1.0, 2.0), (3.0, 2.0))
    solids.velocity[0, :, 0], solids.span[0, 1] = 0.1, 1.0
    then = solids.at(np.array([1.0]))
    np.testing.assert_allclose(then.pose[0, :, 0], [1.0, 3.1])
    np.testing.assert_allclose(then.velocity[0, :, 0], [0.0, 0.1])


def test_no_margin_removes_a_solid_or_makes_one():
    solids = row((1.0, 2.0), (3.0, 2.0), (4.0, 2.0))
    solids.size[0, 1, 0], solids.size[0, 2, 1] = 0.02, 0.0
    for margin in (-0.03, 0.03):
        np.testing.assert_array_equal(solids.wider(margin).filled, [[True, True, False]])
    assert np.isinf(solids.gaps(np.zeros((1, 1, 3)))[0][0, 0]).tolist() == [False, False, True]


def test_stacked_rows_are_filled_up_with_empty_places():
    one, two = row((1.0, 2.0)), row((3.0, 4.0), (5.0, 6.0))
    together = stacked_solids([one, Solids.empty(1), two])
    assert together.filled.tolist() == [[True, False], [False, False], [True, True]]
    for i, part in ((0, one), (2, two)):
        np.testing.assert_array_equal(together.of(np.array([i])).table, part.table)
        again = Solids.from_table(part.table)
        np.testing.assert_array_equal(again.table, part.table)


@pytest.mark.parametrize(("column", "value", "named"), [
    (0, np.nan, "finite"), (1, 1e5, "finite"), (3, 0.0, "extents"), (4, -0.1, "extents"),
    (5, 2.0, "lowest z"), (7, 0.5, "cylinder"), (7, 1.0, "cylinder"), (10, -1.0, "path length"),
    (slice(1), [], "11 numbers"), (0, "left", "11 numbers"),
])  # fmt: skip
def test_invalid_tables_are_errors(column, value, named):
    box = [0.0, 1.0, 0.0, 0.1, 0.2, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    assert Solids.from_table([box, box]).places == 2
    assert Solids.from_table([]).places == 0
    box[column] = value
    with pytest.raises(KinfeasError, match=f"'solids.*{named}"):
        Solids.from_table([box])


def test_rows_get_solids_and_times_of_their_own():
    moving = MovingSolids()
    moving.place(None, np.arange(3), 3)
    assert moving.after() is None
    moving.place(row((1.0, 0.0), (2.0, 0.0)), np.array([1]), 3)
    moving.step(0.5)
    moving.place(row((3.0, 0.0)), np.array([2]), 3)
    np.testing.assert_array_equal(moving.seconds, [0.5, 0.5, 0.0])
    np.testing.assert_array_equal(moving.after().pose[:, :, 0], [[0, 0], [1, 2], [3, 0]])
    again = MovingSolids()
    again.restore(moving.snapshot(), 3)
    for name, values in again.snapshot().items():
        np.testing.assert_array_equal(values, moving.snapshot()[name])
