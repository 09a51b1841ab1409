import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import rotation
from kinfeas.importer.boxed import MARGIN, fit_primitives, volume

pytest.importorskip("trimesh")

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def triangles(points):
    """The convex hull of points as triangles, shape (t, 3, 3)."""
    hull = ConvexHull(points)
    return points[hull.simplices]


def holds(shape, points):
    inner = np.abs(rotation(shape.pose).inv().apply(points - shape.pose[:3]))
    if shape.kind == "box":
        return np.all(inner <= np.array(shape.size) / 2.0, axis=1)
    if shape.kind == "cylinder":
        radius, length = shape.size
        return (np.hypot(inner[:, 0], inner[:, 1]) <= radius) & (inner[:, 2] <= length / 2.0)
    return np.linalg.norm(inner, axis=1) <= shape.size[0]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 60), st.floats(0.01, 2.0))
def test_every_corner_of_a_mesh_lies_in_one_of_its_primitives(seed, count, size):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * rng.uniform(0.1, 1.0, 3) * size + rng.normal(size=3)
    mesh = triangles(points)
    shapes = fit_primitives(mesh)
    assert 1 <= len(shapes) <= 4
    assert np.all(np.any([holds(shape, mesh.reshape(-1, 3)) for shape in shapes], axis=0))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_box_becomes_that_box_wherever_it_lies(seed):
    rng = np.random.default_rng(seed)
    size, turn = np.array([0.2, 0.5, 0.9]), Rotation.random(rng=rng)
    (shape,) = fit_primitives(triangles(turn.apply(CUBE * size) + rng.normal(size=3)))
    assert shape.kind == "box"
    np.testing.assert_allclose(sorted(shape.size), size + 2.0 * MARGIN, atol=1e-6)


@pytest.mark.parametrize("kind", ["cylinder", "sphere"])
def test_what_is_round_becomes_round(kind):
    angle = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if kind == "cylinder":
        points = np.concatenate([np.insert(0.1 * circle, 2, z, axis=1) for z in (-0.3, 0.3)])
    else:
        up = np.linspace(-1.0, 1.0, 25)
        rings = [np.insert(np.sqrt(1.0 - z * z) * circle, 2, z, axis=1) for z in up]
        points = 0.2 * np.unique(np.concatenate(rings).round(9), axis=0)
    (shape,) = fit_primitives(triangles(points))
    assert shape.kind == kind
    assert shape.size[0] == pytest.approx(0.1 if kind == "cylinder" else 0.2, rel=0.02)


def test_an_angle_bracket_is_cut_in_two():
    subgoals = [CUBE * [1.0, 0.1, 0.1] + [0.45, 0, 0], CUBE * [0.1, 0.1, 1.0] + [0, 0, 0.45]]
    shapes = fit_primitives(np.concatenate([triangles(subgoal) for subgoal in subgoals]))
    assert len(shapes) > 1
    assert sum(map(volume, shapes)) < 0.05  # one box around both takes 0.1


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [[1, 2, 3], [1, 2, 3], [1, 2, 3]],
    ],
)
def test_what_is_flat_gets_a_thickness(corners):
    mesh = np.array([corners], dtype=float)
    (shape,) = fit_primitives(mesh)
    assert np.all(holds(shape, mesh.reshape(-1, 3)))
    assert min(shape.size) > 0.0


def test_the_same_mesh_becomes_the_same_primitives():
    mesh = triangles(np.random.default_rng(3).normal(size=(40, 3)))
    once, again = fit_primitives(mesh), fit_primitives(mesh)
    assert [shape.size for shape in once] == [shape.size for shape in again]
    for one, other in zip(once, again, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
