import numpy as np
import pytest

from kinfeas.backends.physics.backend import Stage
from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.scenes.scene import read_scene
from kinfeas.tasks.loading import load_task
from tests.backends.conftest import place, stay


def push(world, force, ticks):
    """Push the drawer with a force in N, and return its joint position."""
    sim = world.sims[0]
    body, link = sim.furniture.link("chest", "drawer")
    client = sim.physics.client
    for _ in range(ticks):
        client.applyExternalForce(body, link, [force, 0, 0], [0, 0, 0], client.LINK_FRAME)
        stay(world, 1, dt=1 / 240)
    return sim.furniture.joint_position("chest", "slide")


def test_objects_are_placed_as_in_the_scene_and_loose_ones_fall(world, begin, scene):
    begin(bar=np.array([3.0, 3.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
    furniture = world.sims[0].furniture
    for name in ("wall", "chest"):
        one = scene.objects[name]
        pose = furniture.link_pose(name, one.urdf.root)
        np.testing.assert_allclose(pose, one.pose, atol=1e-9)
    stay(world, 40)
    assert 0.015 <= furniture.link_pose("bar", "bar")[2] <= 0.06


def test_a_drawer_moves_if_pulled_harder_than_its_friction(world, begin):
    begin()
    assert push(world, 2.0, 60) == pytest.approx(0.0, abs=1e-4)
    assert push(world, 10.0, 60) > 0.05


@pytest.fixture(scope="module")
def room_world(hsr):
    world = PyBulletBackend(hsr, read_scene("room"))
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
        ([0.6295, -2.42, 0.115, 0.0, 0.0, 0.0, 1.0], False),  # on the floor, touching a leg
        ([-0.5, -2.0, 0.115, 0.0, 0.0, 0.0, 1.0], False),  # on the floor
    ],
)
def test_an_object_stands_if_upright_at_rest_on_another(room_world, pose, stands):
    sim = room_world.sims[0]
    place(room_world)
    box, table = (sim.furniture.bodies[name] for name in ("box", "place_table"))
    sim.physics.place(box, np.array(pose) / [1, 1, 1, *[np.linalg.norm(pose[3:])] * 4])
    stay(room_world, 5 if pose[2] == 0.90 else 100)
    if pose[0] == 0.6295:
        assert sim.physics.client.getContactPoints(bodyA=box, bodyB=table)
    stage = Stage(load_task("ggr"), room_world)
    assert stage.stands(0, "box", "place_table") is stands
    sim.physics.client.resetBaseVelocity(box, [0.2, 0.0, 0.0])
    assert not stage.stands(0, "box", "place_table")
