import numpy as np

from kinfeas.backends.pybullet.contacts import contacts
from tests.backends.pybullet.conftest import stay, twist


def test_a_robot_alone_touches_nothing(world, begin):
    begin()
    stay(world, 5)
    assert not world.contacts(0).base
    assert not world.contacts(0).arm


def test_a_base_that_runs_backwards_into_a_wall_touches_it(world, begin):
    begin(x=-2.3)
    stay(world, 150, twist(-0.2))
    wall = world.sims[0].furniture.link("wall", "wall")
    found = world.contacts(0)
    assert {body for _, body, _ in found.base} == {wall[0]}
    assert not found.arm
    assert not contacts(world.sims[0].body, [wall]).base


def test_an_arm_that_reaches_into_a_wall_touches_it(world, begin, between_fingers):
    pose = np.array([*between_fingers[:2], 0.0, 0.0, 0.0, 0.0, 1.0])
    begin(wall=pose)
    stay(world, 2)
    touched = {body for _, body, _ in world.contacts(0).arm}
    assert world.sims[0].furniture.bodies["wall"] in touched
