import numpy as np
import pytest

from kinfeas.core.registry import names
from kinfeas.core.spatial import IDENTITY, planar_pose
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.collision import SceneCollision, robot_touches
from kinfeas.scenes.scene import read_scene


@pytest.fixture(scope="module")
def collision():
    return SceneCollision(read_scene("room"))


@pytest.fixture(scope="module", params=names("kinfeas.robots"))
def robot(request):
    return load_robot(request.param)


def stands(x, y, yaw=0.0):
    return planar_pose(np.array(x), np.array(y), np.array(yaw))


def test_a_robot_in_the_middle_touches_nothing(collision, robot):
    for yaw in np.linspace(-3.0, 3.0, 5):
        assert not robot_touches(collision, robot, stands(0.3, -0.2, yaw), robot.home["home"])


@pytest.mark.parametrize("place", [(3.0, 0.0), (0.0, 2.9), (-2.9, 0.0), (4.95, 3.0), (0.25, -2.75)])
def test_a_robot_within_furniture_or_walls_touches_it(collision, robot, place):
    assert robot_touches(collision, robot, stands(*place), robot.home["home"])


def test_it_does_not_remember_the_last_question(collision, robot):
    free, within = stands(0.0, 0.0), stands(3.0, 0.0)
    answers = [
        robot_touches(collision, robot, pose, robot.home["home"])
        for pose in (free, within, free, within)
    ]
    assert answers == [False, True, False, True]


def test_an_arm_touches_where_a_base_does_not(room, robot):
    rng = np.random.default_rng(0)
    lower = np.array([max(joint.lower, -3.0) for joint in robot.arm])
    upper = np.array([min(joint.upper, 3.0) for joint in robot.arm])
    near = SceneCollision(room)
    base = stands(0.0, 2.2, np.pi / 2.0)
    seen = {robot_touches(near, robot, base, rng.uniform(lower, upper)) for _ in range(200)}
    assert seen == {True, False}


def test_moved_objects_are_found_where_they_are(room, robot):
    table = SceneCollision(room.with_poses({"place_table": stands(0.0, 0.0)}))
    assert robot_touches(table, robot, IDENTITY, robot.home["home"])
