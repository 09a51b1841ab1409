import numpy as np
import pytest

pytest.importorskip("pybullet")

from kinfeas.backends.pybullet.camera import (
    LINK,
    covered_floor,
    keep_moment,
    link_poses,
    show_moment,
    solids,
    take_picture,
    unit_width,
)
from tests.backends.pybullet.conftest import stay, twist

SIZE = (80, 60)
EYE, TARGET = np.array([2.5, -1.5, 1.8]), np.array([0.0, 0.0, 0.5])


def test_the_robot_stands_where_the_camera_looks(world, begin):
    begin()
    picture = take_picture(world.sims[0].physics, EYE, TARGET, SIZE)
    assert picture.colour.shape == (60, 80, 3)
    assert picture.depth.shape == picture.seen.shape == (60, 80)
    assert picture.seen[30, 40] % LINK == world.sims[0].body.body
    assert picture.depth[30, 40] < np.linalg.norm(EYE - TARGET)


def test_what_is_projected_is_found_again(world, begin):
    begin()
    picture = take_picture(world.sims[0].physics, EYE, TARGET, SIZE)
    x, y, depth = picture.project(TARGET[np.newaxis])[0]
    assert (x, y) == pytest.approx((40.0, 30.0), abs=1e-3)
    assert depth == pytest.approx(np.linalg.norm(EYE - TARGET), abs=1e-3)
    # Pixels show points that are projected into them, at their depth.
    places = picture.places()
    back = picture.project(places.reshape(-1, 3)).reshape(60, 80, 3)
    np.testing.assert_allclose(back[..., 0], np.arange(80) + np.zeros((60, 1)), atol=1e-2)
    np.testing.assert_allclose(back[..., 2], picture.depth, rtol=1e-3)
    floor = picture.seen == world.sims[0].physics.floor
    np.testing.assert_allclose(places[floor][:, 2], 0.0, atol=1e-3)


def test_something_stands_on_the_floor_below_the_robot_only(world, begin):
    begin(x=1.0)
    covered = covered_floor(world.sims[0].physics, np.array([1.0, 0.0]), 2.0, 40)
    assert covered[20, 20]
    assert not covered[:4].any()
    assert 0.0 < covered.mean() < 0.3


def test_a_moment_comes_back_as_it_was(world, begin):
    begin()
    stay(world, 10, twist(0.2, 0.0, 0.3))
    links = list(dict.fromkeys((solid.body, solid.link) for solid in solids(world.sims[0].physics)))
    kept, before = (
        keep_moment(world.sims[0].physics),
        link_poses(world.sims[0].physics, links),
    )
    begin(x=-1.0, yaw=2.0)
    assert np.abs(link_poses(world.sims[0].physics, links) - before).max() > 0.5
    show_moment(world.sims[0].physics, kept)
    np.testing.assert_allclose(link_poses(world.sims[0].physics, links), before, atol=1e-9)


def test_all_that_is_seen_but_the_floor(world):
    found = solids(world.sims[0].physics)
    assert {one.body for one in found} == {
        world.sims[0].body.body,
        *world.sims[0].furniture.bodies.values(),
    }
    assert all(min(solid.size) > 0.0 for solid in found)
    assert {len(solid.size) for solid in found if solid.kind == "cylinder"} <= {2}


def test_the_lesser_side_counts():
    assert unit_width((200, 100)) == unit_width((100, 100)) == 2.0 * unit_width((50, 100))
