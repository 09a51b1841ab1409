import numpy as np
import pytest
from matplotlib.figure import Figure

from kinfeas.viz.pictures.projection import Painted, draw_floor, draw_solids, look


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("elevation", [0.0, 0.5, np.pi / 2.0])
def test_a_view_is_a_right_handed_frame(heading, elevation):
    view = look(heading, elevation)
    axes = np.stack([view.right, view.up, view.toward])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_from_above_x_is_right_and_y_is_up():
    point = np.array([[1.0, 2.0, 5.0]])
    np.testing.assert_allclose(look(0.0, np.pi / 2.0).flat(point), [[1.0, 2.0]], atol=1e-12)


def test_from_the_side_z_is_up():
    point = np.array([0.0, 3.0, 5.0])
    np.testing.assert_allclose(look(np.pi / 2.0, 0.0).flat(point), [3.0, 5.0], atol=1e-12)


def test_faces_that_look_away_are_not_drawn():
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    axes = Figure().subplots()
    faces = [Painted(square, "red"), Painted(square[::-1], "blue"), Painted(square + 1.0, "green")]
    draw_solids(axes, look(0.0, np.pi / 2.0), faces)
    drawn = axes.collections[0].get_facecolor()
    assert len(drawn) == 2
    assert drawn[0, 0] > drawn[0, 1], "the red one lies behind the green one"
    assert drawn[1, 1] > drawn[1, 0]


def test_the_floor_lies_under_all_points():
    axes = Figure().subplots()
    view = look(0.4, np.pi / 2.0)
    points = np.random.default_rng(0).uniform(-2.0, 3.0, (20, 3))
    draw_floor(axes, view, points)
    lines = np.concatenate(axes.collections[0].get_segments())
    flat = view.flat(points)
    assert np.all(lines.min(axis=0) <= flat.min(axis=0))
    assert np.all(lines.max(axis=0) >= flat.max(axis=0))


def test_a_floor_too_wide_for_a_grid_has_none():
    axes = Figure().subplots()
    draw_floor(axes, look(0.3, 0.4), np.array([[0.0, 0.0, 0.0], [1e8, 0.0, 0.0]]))
    assert not axes.collections
