"""Points that cover a cube evenly."""

import numpy as np
import pytest

from kinfeas.kinematics.ik import spread


@pytest.mark.parametrize("dimensions", [1, 2, 5, 8])
def test_points_lie_within_the_cube_and_each_axis_is_covered_evenly(dimensions: int) -> None:
    points = spread(1024, dimensions)

    assert points.shape == (1024, dimensions)
    assert (points >= 0.0).all()
    assert (points < 1.0).all()
    for axis in points.T:
        counts, _ = np.histogram(axis, 32, (0.0, 1.0))
        assert counts.min() >= 24
        assert counts.max() <= 40


def test_boxes_hold_as_many_points_as_their_volume_says() -> None:
    points = spread(4096, 3)

    for corner in np.random.default_rng(0).uniform(0.3, 1.0, (50, 3)):
        share = np.all(points < corner, axis=1).mean()
        assert share == pytest.approx(corner.prod(), abs=0.01)


def test_points_go_on_where_others_ended() -> None:
    whole = spread(100, 4)

    np.testing.assert_allclose(np.concatenate([spread(60, 4), spread(40, 4, 60)]), whole)
