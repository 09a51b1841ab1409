import numpy as np
import pytest

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.loading import load_robot
from kinfeas.scenes.scene import read_scene
from tests.backends.pybullet.conftest import stay


def push(world, force, ticks):
    """Push the drawer with a force in N, step by step, and return how far it is open."""
    body, link = world.sims[0].furniture.link("chest", "drawer")
    home = world.sims[0].body.robot.home["home"][np.newaxis]
    frame = world.sims[0].physics.client.LINK_FRAME
    for _ in range(ticks):
        world.sims[0].physics.client.applyExternalForce(body, link, [force, 0, 0], [0, 0, 0], frame)
        world.step(np.zeros((1, 6)), home, 1 / 240)
    return world.sims[0].furniture.joint_position("chest", "slide")


def test_everything_stands_where_the_scene_says(world, begin, scene):
    begin()
    for name, one in scene.objects.items():
        pose = world.sims[0].furniture.link_pose(name, one.urdf.root)
        np.testing.assert_allclose(pose, one.pose, atol=1e-9)


def test_a_drawer_moves_when_it_is_pulled_harder_than_its_friction(world, begin):
    begin()
    assert push(world, 2.0, 60) == pytest.approx(0.0, abs=1e-4)
    assert push(world, 10.0, 60) > 0.05


def test_a_drawer_may_be_open_from_the_beginning(world, begin, scene):
    world.sims[0].furniture.furnish(scene.with_joints({"chest": {"slide": 0.3}}))
    home = world.sims[0].body.robot.home["home"][np.newaxis]
    world.reset(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), home)
    stay(world, 5)
    assert world.sims[0].furniture.joint_position("chest", "slide") == pytest.approx(0.3, abs=1e-4)


def test_what_is_loose_falls(world, begin):
    begin(bar=np.array([3.0, 3.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
    stay(world, 40)
    assert 0.015 <= world.sims[0].furniture.link_pose("bar", "bar")[2] <= 0.06


def test_names_what_there_is(world, begin):
    begin()
    with pytest.raises(KinfeasError, match="there is no object 'tabel'"):
        world.sims[0].furniture.link("tabel", "top")
    with pytest.raises(KinfeasError, match="object 'bar' has no link 'handle'"):
        world.sims[0].furniture.link("bar", "handle")
    with pytest.raises(KinfeasError, match="object 'chest' has no joint 'hinge'"):
        world.sims[0].furniture.joint_position("chest", "hinge")
    with pytest.raises(KinfeasError, match="the scene must have the world's objects"):
        world.sims[0].furniture.furnish(read_scene("room"))


def test_the_shipped_room_stands_still(robot):
    room = read_scene("room")
    world = PyBulletBackend(robot, room)
    home = robot.home["home"][np.newaxis]
    world.reset(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), home)
    stay(world, 25)
    box = world.sims[0].furniture.link_pose("box", room.objects["box"].urdf.root)
    world.close()
    np.testing.assert_allclose(box, room.objects["box"].pose, atol=2e-3)


@pytest.fixture(scope="module")
def room_world():
    world = PyBulletBackend(load_robot("hsr"), read_scene("room"))
    yield world
    world.close()


# The place table is 0.52 m high at (0.25, -2.75), one of its legs ends at x = 0.58, y = -2.42.
@pytest.mark.parametrize(
    ("pose", "stands"),
    [
        ([0.25, -2.75, 0.636, 0.0, 0.0, 0.0, 1.0], True),
        ([0.25, -2.75, 0.636, 0.0, 0.0, 0.7071, 0.7071], True),
        ([0.25, -2.75, 0.60, 0.7071, 0.0, 0.0, 0.7071], False),  # on its side
        ([0.25, -2.75, 0.90, 0.0, 0.0, 0.0, 1.0], False),  # still falling
        ([0.6295, -2.42, 0.115, 0.0, 0.0, 0.0, 1.0], False),  # on the floor, at a sub-goal
        ([-0.5, -2.0, 0.115, 0.0, 0.0, 0.0, 1.0], False),  # on the floor
    ],
)
def test_what_stands_rests_upright_on_something(room_world, pose, stands):
    sim = room_world.sims[0]
    sim.furniture.furnish(read_scene("room"))
    home = sim.body.robot.home["home"][np.newaxis]
    room_world.reset(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), home)
    box = sim.furniture.bodies["box"]
    sim.physics.place(box, np.array(pose) / [1, 1, 1, *[np.linalg.norm(pose[3:])] * 4])
    stay(room_world, 5 if pose[2] == 0.90 else 100)
    client = sim.physics.client
    if pose[0] == 0.6295:  # it is a case of touching at all
        assert client.getContactPoints(bodyA=box, bodyB=sim.furniture.bodies["place_table"])
    assert sim.furniture.stands("box", "place_table") is stands
