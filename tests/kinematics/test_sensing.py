import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import compose, yaw
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.kinematics.sensing import base_obstacles, base_prisms, fine_base_prisms, scan
from kinfeas.kinematics.solids import in_base
from tests.builders import at
from tests.kinematics.conftest import Among, draw_bases, draw_solids


def test_base_obstacles_are_nearest_points(hsr):
    """HSR's base has upright shapes only: for solids as high as the room they are exact."""
    prisms, n = base_prisms(build_collision_model(hsr)), 100
    bases, solids, home = draw_bases(n), draw_solids(n, 1), hsr.home["home"]
    solids.size[:, :, 2:] = [0.0, 3.0]
    near = base_obstacles(prisms, bases, solids, 1.0)
    among, local = Among(hsr), in_base(solids, bases)
    exact = np.array([among.distances(home, local, row)[0] for row in range(n)])
    nearest = near.distance.min(axis=1)
    free = (exact > 0.0) & (exact < 1.0)
    assert free.sum() > 15
    np.testing.assert_allclose(nearest[free], exact[free], atol=2e-5)
    assert np.all(nearest[exact >= 1.0] == np.inf)
    first = near.distance.argmin(axis=1)[:, np.newaxis, np.newaxis]
    step = np.pad(1e-4 * np.take_along_axis(near.normal, first, axis=1)[:, 0], ((0, 0), (0, 5)))
    step[:, 6] = 1.0
    closer = base_obstacles(prisms, compose(bases, step), solids, 1.0).distance.min(axis=1)
    np.testing.assert_allclose(nearest[free] - closer[free], 1e-4, atol=1e-6)


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
    obstacles = base_obstacles(base_prisms(model), at(), wall, 1.0)
    points = obstacles.closest_point[0, np.isfinite(obstacles.distance[0])]
    np.testing.assert_allclose(obstacles.distance.min(), 0.2, atol=1e-9)
    assert {tuple(point.round(3)) for point in points} == {
        (round(front, 3), side) for side in model.size[0, 1].round(3) * np.array([-1.0, 1.0])
    }
    np.testing.assert_allclose(obstacles.normal[0], [[1.0, 0.0]] * len(points), atol=1e-12)
    wall.size[0, 0, 2:] = [1.5, 2.0]
    above = base_obstacles(base_prisms(model), at(), wall, 1.0)
    assert above.distance.size == 0


BANDS = ((0.0, 0.35), (0.35, 1.5))


def inside(points, solids, row, low, high):
    """Return which world points (m, 2) are within solids whose heights overlap the band."""
    hits = np.zeros(len(points), dtype=np.bool_)
    for (x, y, turn), size, cylinder in zip(
        solids.pose[row], solids.size[row], solids.cylinder[row], strict=True
    ):
        if size[0] > 0.0 and size[2] < high and size[3] > low:
            own = (points - [x, y]) @ Rotation.from_euler("z", turn).as_matrix()[:2, :2]
            within = np.hypot(*own.T) < size[0]
            hits |= within if cylinder else np.all(np.abs(own) < size[:2], axis=1)
    return hits


def test_beams_end_at_the_first_solid():
    n, beams, longest = 20, 48, 3.0
    solids, bases = draw_solids(n, 8), draw_bases(n)
    ranges = scan(solids, bases, BANDS, beams, longest)
    assert ranges.shape == (n, 2, beams)
    steps = np.linspace(0.0, longest, 1501)
    for row, pose in enumerate(bases):
        angles = yaw(pose) - np.pi + 2.0 * np.pi * np.arange(beams) / beams
        ways = steps[:, np.newaxis] * np.stack([np.cos(angles), np.sin(angles)])[:, np.newaxis]
        points = (pose[:2, np.newaxis, np.newaxis] + ways).reshape(2, -1).T
        for band, (low, high) in enumerate(BANDS):
            hit = inside(points, solids, row, low, high).reshape(len(steps), beams)
            sampled = np.where(hit.any(axis=0), steps[hit.argmax(axis=0)], longest)
            exact = ranges[row, band]
            assert np.all(sampled >= exact - 1e-9)
            # A sample may step over a corner: the middle of the way to it is inside, then.
            entry = pose[:2] + (exact + 1e-6)[:, np.newaxis] * np.stack(
                [np.cos(angles), np.sin(angles)], axis=1
            )
            assert np.all(inside(entry, solids, row, low, high) | (exact == longest))
    assert np.any(ranges == 0.0)
    assert 0.1 < np.mean(ranges == longest) < 0.9


def test_beam_zero_points_backwards_and_bands_are_open_at_touching_solids():
    solids = Solids.empty(1, 2)
    solids.pose[0, :, :2] = [[-1.0, 0.0], [0.0, 1.0]]
    solids.size[0] = [[0.2, 0.3, 0.0, 0.35], [0.2, 0.3, 0.35, 2.0]]
    ranges = scan(solids, at(), BANDS, 4, 5.0)
    np.testing.assert_allclose(ranges[0], [[0.8, 5.0, 5.0, 5.0], [5.0, 5.0, 5.0, 0.7]])


def test_a_flat_mesh_belongs_to_the_base(hsr):
    plate = np.array([[x, y, 0.2] for x in (1.0, 1.4) for y in (-0.2, 0.2)])
    prisms, wall = fine_base_prisms(build_collision_model(hsr), [plate]), Solids.empty(1, 1)
    wall.pose[0, 0, 0], wall.size[0, 0] = 2.0, [0.1, 2.0, 0.0, 3.0]
    near = base_obstacles(prisms, at(), wall, 1.0)
    np.testing.assert_allclose(near.distance.min(), 0.5, atol=1e-9)
