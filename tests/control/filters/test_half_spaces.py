import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from kinfeas.control.filters.half_spaces import project

SLACK = 1e-6


def nearest(point, normals, offsets):
    """Return the point of the half-spaces that is nearest.

    Least distance programming (Lawson and Hanson, "Solving Least Squares Problems", chapter 23).
    """
    over = normals @ point - offsets
    tall = np.vstack([-normals.T, over])
    target = np.zeros(len(tall))
    target[-1] = 1.0
    residual = tall @ nnls(tall, target)[0] - target
    return point - residual[:-1] / residual[-1]


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), count=st.integers(1, 24), size=st.integers(2, 3))
def test_points_outside_come_to_the_nearest_point_and_others_stay(seed, count, size):
    rng = np.random.default_rng(seed)
    normals = rng.normal(scale=0.2, size=(count, size))
    normals[:, -1] *= rng.choice([1.0, 20.0])  # rotations: borders are nearly parallel
    offsets = np.maximum(rng.uniform(-0.1, 0.2, count), 0.0)  # some borders have the origin
    for point in rng.uniform(-1.0, 1.0, (10, size)):
        moved = point.copy()
        outside = project(moved, normals, offsets, SLACK)
        assert outside == ((normals @ point - offsets).max() > SLACK)
        assert (normals @ moved - offsets).max() <= 2.0 * SLACK
        expected = nearest(point, normals, offsets) if outside else point
        np.testing.assert_allclose(moved, expected, atol=1e-5 if outside else 0.0)


@pytest.mark.parametrize(("point", "normals", "offsets", "expected"), [
    ([0.5, 0.3], [[1.0, 0.0], [0.0, 1.0]], [-0.2, 0.4], [-0.2, 0.3]),  # the origin is outside
    ([-0.5, 0.2], [[1.0, 0.0], [0.0, 1.0]], [-0.2, 0.4], [-0.5, 0.2]),
    # Without a common point they are widened.
    ([0.5, 0.7], [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]], [-0.2, -0.1, 0.3], [0.0, 0.3]),
])  # fmt: skip
def test_half_spaces_without_the_origin(point, normals, offsets, expected):
    moved = np.array(point)
    outside = project(moved, np.array(normals), np.array(offsets), SLACK)
    assert outside == (point != expected)
    np.testing.assert_allclose(moved, expected, atol=1e-5)
