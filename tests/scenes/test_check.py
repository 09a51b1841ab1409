from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose, planar_pose
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.kinematics.solids import collides
from kinfeas.robots.fcl_shapes import fcl_object, touch
from kinfeas.robots.loading import load_robot
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.scene import furniture_solids, read_scene, solid_names

SIZES = {"box": (0.2, 0.2, 0.2), "cylinder": (0.1, 0.2), "sphere": (0.1,)}
SHELF = "[-1.0, 0.0, 0.4]"
AROUND = ", rpy: [0.0, 0.0, 3.141592653589793]"


def at(kind, x):
    return Shape(kind, SIZES[kind], floor(x, 0.0))


def floor(x, y, yaw=0.0):
    return planar_pose(np.array(x), np.array(y), np.array(yaw))


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("other", SIZES)
def test_shapes_touch_where_their_surfaces_meet(kind, other):
    for x, touching in ((0.199, True), (0.201, False)):
        assert touch(fcl_object(at(kind, x)), fcl_object(at(other, 0.0))) == touching


@pytest.mark.parametrize(("old", "new", "where"), [
    (SHELF, "[0.8, 0.1, 0.4]", "'table' and 'shelf'"),
    (SHELF, "[1.0, 0.0, 0.5185]", "'table' and 'shelf'"),  # the table's top is at 0.52 m
    (SHELF, "[-2.5, 0.0, 0.4]", r"'shelf'.*\(-2.5, 0\)"),
    ("[1.0, 0.0, 0.0]", "[1.0, 0.0, -0.1]", "'table'.*0.1 m below"),
])  # fmt: skip
def test_overlaps_are_errors(write, old, new, where):
    with pytest.raises(KinfeasError, match=where):
        read_scene(write(old, new))


@pytest.mark.parametrize("height", [0.5195, 0.52, 0.53])
def test_an_object_may_be_on_another_one(write, height):
    read_scene(write(SHELF, f"[1.0, 0.0, {height}]{AROUND}"))


THING = "{name: own, size: [4, 4], objects: {thing: {urdf: thing.urdf, position: [1, 0, 0.5]}}}"
BOX = "<collision><geometry><box size='.1 .1 .1'/></geometry></collision>"
JOINT = "<joint name='j' type='{}'><parent link='a'/><child link='b'/><axis xyz='1 0 0'/>"
JOINT += "<limit lower='0' upper='1'/></joint>"


def inertial(mass="1", ixx="1", iyy="1", izz="1", ixy="0"):
    moments = f"ixx='{ixx}' iyy='{iyy}' izz='{izz}' ixy='{ixy}' ixz='0' iyz='0'"
    return f"<inertial><mass value='{mass}'/><inertia {moments}/></inertial>"


@pytest.fixture
def read(tmp_path):
    def read_thing(root, child=None, kind="prismatic", fixed=False):
        links = f"<link name='a'>{BOX}{root}</link>"
        if child is not None:
            links += f"<link name='b'>{child}</link>{JOINT.format(kind)}"
        (tmp_path / "thing.urdf").write_text(f"<robot name='r'>{links}</robot>")
        (tmp_path / "own.yaml").write_text(THING)
        return read_scene(str(tmp_path / "own.yaml"), {"objects.thing.fixed": fixed})

    return read_thing


@pytest.mark.parametrize("broken", [
    "", inertial(mass="0"), inertial(ixx="0", iyy="0", izz="0"), inertial(ixy="2"),
    inertial(ixx="1", iyy="0.1", izz="0.1"),
])  # fmt: skip
def test_moving_links_need_a_possible_inertia(read, broken):
    with pytest.raises(KinfeasError, match=r"thing\.urdf: link 'a'"):
        read(broken)
    with pytest.raises(KinfeasError, match=r"thing\.urdf: link 'b'"):
        read(inertial(), broken, fixed=True)
    read(broken, fixed=True)


def test_scenes_without_fixed_objects_have_no_solids(read):
    assert furniture_solids(read(inertial())).places == 0


def test_possible_inertias_pass(read):
    read(inertial(ixx="2", iyy="1", izz="1"))  # a plate
    read(inertial(), inertial(mass="0"), kind="fixed")  # a frame on it


def robot_shapes(robot, base_pose, joints):
    arm = dict(zip((joint.name for joint in robot.arm), joints, strict=True))
    poses = robot.urdf.link_poses({**robot.fixed_joints, **arm}, base_pose)
    for link in robot.urdf.links.values():
        for shape in link.shapes:
            yield replace(shape, pose=compose(poses[link.name], shape.pose))


@pytest.mark.parametrize("name", ["room", "shelf", "doorway"])
def test_robots_touch_the_solids_that_they_touch_as_furniture(name):
    robot, scene, rng = load_robot("hsr"), read_scene(name), np.random.default_rng(0)
    fixed = {key: one for key, one in scene.objects.items() if one.fixed}
    scene.objects.clear()
    scene.objects.update(fixed)
    solids = furniture_solids(scene)
    furniture = [fcl_object(shape) for thing in fixed.values() for _, shape in thing.shapes()]
    lower, upper = robot.finite_joint_limits
    joints = rng.uniform(lower, upper, (400, len(lower)))
    base = planar_pose(*rng.uniform([-4.0, -4.0, -np.pi], [4.0, 4.0, np.pi], (400, 3)).T)
    rows = solids.of(np.zeros(400, dtype=np.intp))
    touching = collides(build_collision_model(robot), joints, base, rows).any(axis=1)
    expected = [
        any(touch(*pair) for pair in product(map(fcl_object, robot_shapes(robot, *row)), furniture))
        for row in zip(base, joints, strict=True)
    ]
    assert touching[expected].all()
    assert 0.0 < np.mean(expected) <= np.mean(touching) <= np.mean(expected) + 0.01


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
    assert furniture_solids(room, movable=True).places == len(solid_names(room)) > len(shapes)
