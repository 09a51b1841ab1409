import numpy as np
import pytest

from kinfeas.backends.pybullet.camera import (
    LINK,
    keep_moment,
    link_poses,
    show_moment,
    take_picture,
    visual_shapes,
)
from tests.backends.pybullet.conftest import stay, twist

EYE, TARGET = np.array([2.5, -1.5, 1.8]), np.array([0.0, 0.0, 0.5])


def test_a_picture_shows_the_target_in_its_middle(world, begin):
    begin()
    picture = take_picture(world.sims[0].physics, EYE, TARGET, (80, 60))
    assert picture.colour.shape == (60, 80, 3)
    assert picture.depth.shape == picture.seen.shape == (60, 80)
    assert picture.seen[30, 40] % LINK == world.sims[0].body.body
    assert picture.depth[30, 40] < np.linalg.norm(EYE - TARGET)
    x, y, depth = picture.project(TARGET[np.newaxis])[0]
    assert (x, y) == pytest.approx((40.0, 30.0), abs=1e-3)
    assert depth == pytest.approx(np.linalg.norm(EYE - TARGET), abs=1e-3)


def test_depth_agrees_with_the_projection(world, begin):
    begin(x=5.0)
    picture = take_picture(world.sims[0].physics, EYE, TARGET, (80, 60))
    points = np.column_stack([np.random.default_rng(0).uniform(-0.4, 0.4, (50, 2)), np.zeros(50)])
    x, y, depth = picture.project(points).T
    np.testing.assert_allclose(picture.depth[y.astype(int), x.astype(int)], depth, atol=0.15)


def test_a_moment_is_restored(world, begin):
    begin()
    stay(world, 10, twist(0.2, 0.0, 0.3))
    physics = world.sims[0].physics
    links = list(dict.fromkeys((one.body, one.link) for one in visual_shapes(physics)))
    kept, before = keep_moment(physics), link_poses(physics, links)
    begin(x=-1.0, yaw=2.0)
    assert np.abs(link_poses(physics, links) - before).max() > 0.5
    show_moment(physics, kept)
    np.testing.assert_allclose(link_poses(physics, links), before, atol=1e-9)


def test_visual_shapes_are_those_of_robot_and_furniture(world):
    sim = world.sims[0]
    found = visual_shapes(sim.physics)
    assert {one.body for one in found} == {sim.body.body, *sim.furniture.bodies.values()}
    sizes = {"box": 3, "cylinder": 2, "sphere": 1}
    assert all(len(one.shape.size) == sizes[one.shape.kind] for one in found)
    assert all(min(one.shape.size) > 0.0 for one in found)
