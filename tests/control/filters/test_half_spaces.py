import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from kinfeas.control.filters.half_spaces import project

SLACK = 1e-6


def nearest(point, normals, offsets):
    """Return the point of the half-spaces that is nearest, by an independent way.

    Least distance programming (Lawson and Hanson, "Solving Least Squares Problems", chapter 23).
    """
    over = normals @ point - offsets
    tall = np.vstack([-normals.T, over])
    target = np.zeros(len(tall))
    target[-1] = 1.0
    residual = tall @ nnls(tall, target)[0] - target
    return point - residual[:-1] / residual[-1]


def drawn(seed, count=4, size=3):
    """Return points and half-spaces, some of which have the origin on their border."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (40, 3, size))
    normals = rng.normal(scale=0.2, size=(40, count, size))
    normals[..., -1] *= rng.choice([1.0, 20.0], (40, 1))  # rotations: borders are nearly parallel
    return points, normals, np.maximum(rng.uniform(-0.1, 0.2, (40, count)), 0.0)


def put(points, normals, offsets):
    moved = points.copy()
    each = zip(moved, normals, offsets, strict=True)
    outside = [[project(point, *rows, SLACK) for point in some] for some, *rows in each]
    return moved, np.array(outside)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 8), size=st.integers(2, 3))
def test_all_are_within_and_those_that_were_stay_where_they_are(seed, count, size):
    points, normals, offsets = drawn(seed, count=count, size=size)
    moved, outside = put(points, normals, offsets)
    excess = np.einsum("nta,nka->ntk", moved, normals) - offsets[:, np.newaxis]
    assert excess.max() <= 2.0 * SLACK
    before = np.einsum("nta,nka->ntk", points, normals) - offsets[:, np.newaxis]
    np.testing.assert_array_equal(outside, before.max(axis=2) > SLACK)
    np.testing.assert_array_equal(moved[~outside], points[~outside])


@pytest.mark.parametrize(("count", "size"), [(1, 2), (2, 2), (2, 3), (4, 3), (24, 3)])
def test_points_come_to_the_nearest_place(count, size):
    points, normals, offsets = drawn(0, count=count, size=size)
    moved, outside = put(points, normals, offsets)
    assert outside.sum() > 20
    away = [
        np.linalg.norm(moved[row, one] - nearest(points[row, one], normals[row], offsets[row]))
        for row, one in np.argwhere(outside)
    ]
    assert max(away) < 1e-5


def test_points_are_pushed_out_of_the_origin_s_place():
    normals = np.array([[[1.0, 0.0], [0.0, 1.0]]])
    moved, outside = put(np.array([[[0.5, 0.3], [-0.5, 0.2]]]), normals, np.array([[-0.2, 0.4]]))
    np.testing.assert_array_equal(outside, [[True, False]])
    np.testing.assert_allclose(moved[0], [[-0.2, 0.3], [-0.5, 0.2]], atol=1e-5)


def test_half_spaces_without_a_common_point_are_widened():
    normals = np.array([[[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]]])
    moved, _ = put(np.array([[[0.5, 0.7]]]), normals, np.array([[-0.2, -0.1, 0.3]]))
    np.testing.assert_allclose(moved[0, 0], [0.0, 0.3], atol=1e-5)
