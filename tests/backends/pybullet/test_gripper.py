import numpy as np
import pytest

from kinfeas.backends.pybullet.physics import ROOT
from kinfeas.core import spatial
from tests.backends.conftest import place, stay


@pytest.fixture
def grasped(world, begin, between_fingers):
    """A simulation in which the hand has just grasped the bar."""
    begin(bar=between_fingers)
    sim = world.sims[0]
    sim.physics.client.setGravity(0.0, 0.0, 0.0)
    bar = sim.furniture.link("bar", "bar")
    sim.gripper.close()
    for _ in range(40):
        stay(world, 1)
        if sim.grasp.hold(*bar):
            break
    sim.physics.client.setGravity(0.0, 0.0, -9.81)
    assert sim.grasp.held == bar
    return sim


def in_hand(sim):
    hand = sim.body.links[sim.body.robot.ee_frame]
    hand_pose = sim.physics.link_pose(sim.body.body, hand)
    return spatial.relative(sim.furniture.link_pose("bar", "bar"), hand_pose)


def test_opens_and_closes(world, begin):
    begin()
    gripper = world.sims[0].gripper
    assert 0.3 <= gripper.opening <= 0.7
    gripper.open()
    stay(world, 75)
    assert gripper.opening == pytest.approx(1.0, abs=1e-3)
    gripper.close()
    stay(world, 150)
    assert gripper.opening == pytest.approx(0.0, abs=1e-3)


def test_a_grasp_needs_both_fingers(world, begin, grasped, monkeypatch):
    wall = grasped.furniture.bodies["wall"]
    assert grasped.gripper.opening > 0.1
    assert grasped.gripper.touching(wall, ROOT) == frozenset()
    begin()
    assert grasped.grasp.held is None
    assert grasped.furniture.link_pose("bar", "bar")[0] == pytest.approx(3.0)
    for fingers in ((), (0,), (1,)):
        monkeypatch.setattr(grasped.gripper, "touching", lambda *_, some=fingers: {*some})
        assert not grasped.grasp.hold(*grasped.furniture.link("bar", "bar"))
    assert grasped.grasp.held is None


def test_a_held_object_moves_with_the_hand(world, grasped):
    before = in_hand(grasped)
    stay(world, 50)
    metres, radians = spatial.distance(before, in_hand(grasped))
    assert metres <= 0.003
    assert radians <= 0.05
    assert grasped.grasp.held is not None


def test_the_grasp_carries_the_weight_until_it_is_released(world, grasped):
    grasped.gripper.open()
    stay(world, 60)
    assert grasped.grasp.force == pytest.approx(0.3 * 9.81, rel=0.05)
    grasped.grasp.release()
    stay(world, 40)
    assert grasped.grasp.held is None
    assert grasped.furniture.link_pose("bar", "bar")[2] < 0.25


def test_the_grasp_breaks_above_its_limit(world, grasped):
    bar, _ = grasped.furniture.link("bar", "bar")
    stay(world, 20)
    assert grasped.grasp.held is not None
    client = grasped.physics.client
    for _ in range(20):  # a force lasts one physics step
        at = grasped.furniture.link_pose("bar", "bar")[:3].tolist()
        client.applyExternalForce(bar, -1, [0.0, 0.0, 400.0], at, client.WORLD_FRAME)
        stay(world, 1, dt=1 / 240)
    assert grasped.grasp.held is None


def test_a_closing_gripper_grasps_the_link_that_is_set(hsr, scene, opened, between_fingers):
    world = opened(hsr, scene.with_poses({"bar": between_fingers}))
    world.handle("bar", "bar")
    place(world)
    sim = world.sims[0]
    sim.physics.client.setGravity(0.0, 0.0, 0.0)
    stay(world, 30)
    assert sim.gripper.opening > 0.9  # open after a reset
    world.grip("close", np.array([0]))
    stay(world, 60)
    assert sim.grasp.held == sim.furniture.link("bar", "bar")
    world.grip("open", np.array([0]))
    assert sim.grasp.held is None
