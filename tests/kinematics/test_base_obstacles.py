import numpy as np

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose
from kinfeas.kinematics.base_obstacles import base_obstacles, base_prisms
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.kinematics.solids import distances
from tests.builders import at
from tests.kinematics.conftest import draw, draw_bases, draw_solids


def test_base_obstacles_are_nearest_points(hsr):
    """HSR's base has upright shapes only: for solids as high as the room they are exact."""
    model, n = build_collision_model(hsr), 300
    bases, solids, joints = draw_bases(n), draw_solids(n, 1), draw(hsr, n)
    solids.size[:, :, 2:] = [0.0, 3.0]
    near = base_obstacles(base_prisms(model), bases, solids, 1.0)
    exact = distances(model, joints, bases, solids)[:, 0]
    nearest = near.distance.min(axis=1)
    free = (exact > 0.0) & (exact < 1.0)
    assert free.sum() > 50
    np.testing.assert_allclose(nearest[free], exact[free], atol=1e-6)
    assert np.all(nearest[exact >= 1.0] == np.inf)
    first = near.distance.argmin(axis=1)[:, np.newaxis, np.newaxis]
    normal = np.take_along_axis(near.normal, first, axis=1)[:, 0]
    np.testing.assert_allclose(np.linalg.norm(normal[free], axis=1), 1.0)
    step = np.zeros((n, 7))
    step[:, :2], step[:, 6] = 1e-4 * normal, 1.0
    closer = distances(model, joints, compose(bases, step), solids)[:, 0]
    np.testing.assert_allclose(exact[free] - closer[free], 1e-4, atol=1e-6)


def test_closing_speeds_are_those_at_which_distances_shrink(hsr):
    model, n, dt = build_collision_model(hsr), 100, 1e-5
    bases, solids = draw_bases(n), draw_solids(n, 1)
    solids.size[:, :, 2:] = [0.0, 3.0]
    solids.velocity[:], solids.span[:] = np.random.default_rng(0).normal(size=(n, 1, 2)), 9.0
    near, later = (
        base_obstacles(base_prisms(model), bases, solids.at(np.full(n, seconds)), 9.0)
        for seconds in (0.0, dt)
    )
    one, other = near.distance.min(axis=1), later.distance.min(axis=1)
    first = near.distance.argmin(axis=1)[:, np.newaxis]
    speed = np.take_along_axis(near.closing_speed, first, axis=1)[:, 0]
    known = (one > 1e-3) & np.isfinite(one)
    assert known.sum() > 50
    np.testing.assert_allclose(speed[known], (one[known] - other[known]) / dt, atol=1e-3)


def test_a_parallel_wall_has_the_corners_of_the_base(pr2):
    model, wall = build_collision_model(pr2), Solids.empty(1, 1)
    front = model.offset[0, 0] + model.size[0, 0]
    wall.pose[0, 0, 0], wall.size[0, 0] = front + 0.3, [0.1, 2.0, 0.0, 0.2]
    found = base_obstacles(base_prisms(model), at(), wall, 1.0)
    points = found.closest_point[0, np.isfinite(found.distance[0])]
    np.testing.assert_allclose(found.distance.min(), 0.2, atol=1e-9)
    assert {tuple(point.round(3)) for point in points} == {
        (round(front, 3), side) for side in model.size[0, 1].round(3) * np.array([-1.0, 1.0])
    }
    np.testing.assert_allclose(found.normal[0], [[1.0, 0.0]] * len(points), atol=1e-12)
    wall.size[0, 0, 2:] = [1.5, 2.0]
    above = base_obstacles(base_prisms(model), at(), wall, 1.0)
    assert above.distance.size == 0
    wall.pose[0, 0, 0], wall.size[0, 0, 2:] = front + 0.05, [0.0, 0.2]
    np.testing.assert_allclose(
        base_obstacles(base_prisms(model), at(), wall, 1.0).distance.min(), -0.05
    )
