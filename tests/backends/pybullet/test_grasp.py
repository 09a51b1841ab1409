import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from tests.backends.pybullet.conftest import stay


@pytest.fixture
def grasped(world, begin, between_fingers):
    """A world in which the hand has just taken hold of the bar."""
    begin(bar=between_fingers)
    world.sims[0].physics.client.setGravity(0.0, 0.0, 0.0)
    bar = world.sims[0].furniture.link("bar", "bar")
    world.sims[0].gripper.close()
    for _ in range(40):
        stay(world, 1)
        if world.sims[0].grasp.hold(*bar):
            break
    world.sims[0].physics.client.setGravity(0.0, 0.0, -9.81)
    assert world.sims[0].grasp.held == bar
    return world


def in_hand(world):
    hand = world.sims[0].body.links[world.sims[0].body.robot.ee_frame]
    hand_pose = world.sims[0].physics.link_pose(world.sims[0].body.body, hand)
    return spatial.relative(world.sims[0].furniture.link_pose("bar", "bar"), hand_pose)


def test_forms_only_where_both_fingers_touch(world, begin):
    begin()
    assert not world.sims[0].grasp.hold(*world.sims[0].furniture.link("bar", "bar"))
    assert world.sims[0].grasp.held is None


def test_what_is_held_moves_with_the_hand(grasped):
    before = in_hand(grasped)
    stay(grasped, 50)
    metres, radians = spatial.distance(before, in_hand(grasped))
    assert metres <= 0.003
    assert radians <= 0.05
    assert grasped.sims[0].grasp.held is not None
    assert grasped.sims[0].grasp.force > 0.0


def test_exerts_the_weight_of_what_it_holds(grasped):
    grasped.sims[0].gripper.open()
    stay(grasped, 60)
    assert grasped.sims[0].grasp.force == pytest.approx(0.3 * 9.81, rel=0.05)


def test_what_is_released_falls(grasped):
    stay(grasped, 10)
    grasped.sims[0].gripper.open()
    grasped.sims[0].grasp.release()
    stay(grasped, 40)
    assert grasped.sims[0].grasp.held is None
    assert grasped.sims[0].furniture.link_pose("bar", "bar")[2] < 0.25


def test_breaks_above_a_force(grasped):
    bar, _ = grasped.sims[0].furniture.link("bar", "bar")
    home = grasped.sims[0].body.robot.home["home"][np.newaxis]
    stay(grasped, 20)
    assert grasped.sims[0].grasp.held is not None
    # A force lasts one physics step: a control period of one sees all of it.
    for _ in range(20):
        at = grasped.sims[0].furniture.link_pose("bar", "bar")[:3].tolist()
        frame = grasped.sims[0].physics.client.WORLD_FRAME
        grasped.sims[0].physics.client.applyExternalForce(bar, -1, [0.0, 0.0, 400.0], at, frame)
        grasped.step(np.zeros((1, 6)), home, 1 / 240)
    assert grasped.sims[0].grasp.held is None


def test_a_reset_lets_go(grasped, begin):
    begin()
    assert grasped.sims[0].grasp.held is None
    assert grasped.sims[0].furniture.link_pose("bar", "bar")[0] == pytest.approx(3.0)


def test_one_thing_at_a_time(grasped):
    with pytest.raises(KinfeasError, match="holds an object already"):
        grasped.sims[0].grasp.hold(*grasped.sims[0].furniture.link("bar", "bar"))
