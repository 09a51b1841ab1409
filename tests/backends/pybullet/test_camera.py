import numpy as np
import pytest

from kinfeas.backends.pybullet.camera import (
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
    physics = world.sims[0].physics
    here = take_picture(physics, EYE, TARGET, (80, 60))
    assert here.colour.shape == (60, 80, 3)
    x, y, depth = here.project(TARGET[np.newaxis])[0]
    assert (x, y) == pytest.approx((40.0, 30.0), abs=1e-3)
    assert depth == pytest.approx(np.linalg.norm(EYE - TARGET), abs=1e-3)
    _, above, _ = here.project(TARGET[np.newaxis] + [0.0, 0.0, 0.3])[0]
    assert 0.0 < above < y
    begin(x=5.0)
    away = take_picture(physics, EYE, TARGET, (80, 60))
    changed = np.argwhere(np.any(here.colour != away.colour, axis=-1))
    assert np.abs(np.median(changed, axis=0) - [30, 40]).max() < 8  # the robot was there


def test_a_moment_is_restored(world, begin):
    begin()
    stay(world, 10, twist(0.2, 0.0, 0.3))
    physics = world.sims[0].physics
    shapes = visual_shapes(physics)
    links = list(dict.fromkeys((one.body, one.link) for one in shapes))
    assert {one.body for one in shapes} == {*range(physics.client.getNumBodies())} - {physics.floor}
    kept, before = keep_moment(physics), link_poses(physics, links)
    begin(x=-1.0, yaw=2.0)
    assert np.abs(link_poses(physics, links) - before).max() > 0.5
    show_moment(physics, kept)
    np.testing.assert_allclose(link_poses(physics, links), before, atol=1e-9)
