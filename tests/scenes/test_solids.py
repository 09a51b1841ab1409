import numpy as np
import pytest

from kinfeas.core.spatial import planar_pose
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.kinematics.solids import collides
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.collision import SceneCollision, robot_touches
from kinfeas.scenes.scene import read_scene
from kinfeas.scenes.solids import furniture_solids


@pytest.mark.parametrize("name", ["room", "shelf", "doorway"])
def test_robots_touch_the_solids_that_they_touch_as_furniture(name):
    robot, scene, rng = load_robot("hsr"), read_scene(name), np.random.default_rng(0)
    fixed = {key: one for key, one in scene.objects.items() if one.fixed}
    scene.objects.clear()
    scene.objects.update(fixed)
    furniture, solids = SceneCollision(scene), furniture_solids(scene)
    lower, upper = robot.finite_joint_limits
    joints = rng.uniform(lower, upper, (400, len(lower)))
    base = planar_pose(*rng.uniform([-4.0, -4.0, -np.pi], [4.0, 4.0, np.pi], (400, 3)).T)
    rows = solids.of(np.zeros(400, dtype=np.intp))
    found = collides(build_collision_model(robot), joints, base, rows).any(axis=1)
    expected = [robot_touches(furniture, robot, *row) for row in zip(base, joints, strict=True)]
    assert found[expected].all()
    assert 0.0 < np.mean(expected) <= np.mean(found) <= np.mean(expected) + 0.01


def test_grasped_links_and_movable_objects_are_no_solids():
    room = read_scene("room")
    everything = furniture_solids(room)
    without = furniture_solids(room, ("drawer_shelf", "handle"))
    moved = [link for link, _ in room.objects["drawer_shelf"].shapes() if link != "body"]
    assert everything.places - without.places == len(moved)
    opened = room.with_joints({"door_shelf": {"hinge": 1.0}})
    assert not np.array_equal(furniture_solids(opened).pose, everything.pose)
    shapes = [one for name in room.objects for one in room.objects[name].shapes() if name != "box"]
    assert everything.places == len(shapes)
