import numpy as np
import pytest

from kinfeas.core.backend import SCAN_BEAMS
from kinfeas.core.spatial import planar_pose
from kinfeas.envs.world import World, WorldConfig
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task


def test_furniture_is_scanned_and_has_distances_in_the_analytic_world():
    robot = load_robot("hsr")
    world = World(robot, load_task("shelf"), WorldConfig(), 0)
    world.start([0])
    before_shelf = planar_pose(np.array([2.0]), np.zeros(1), np.zeros(1))
    world.backend.reset(before_shelf, robot.home["home"][np.newaxis], np.zeros(1, dtype=np.intp))
    ahead = world.backend.scan()[0, :, SCAN_BEAMS // 2]
    np.testing.assert_allclose(ahead, 0.5)
    found = world.backend.obstacle_distances(1.0)
    assert found.distance.min() == pytest.approx(0.5 - 0.226, abs=0.01)  # the base's radius
    world.close()
