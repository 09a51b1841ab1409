import numpy as np

from kinfeas.backends.pybullet.contacts import Contacts, Touched, contacts
from tests.backends.pybullet.conftest import stay, twist


def test_a_robot_alone_touches_nothing(world, begin):
    begin()
    stay(world, 5)
    assert world.sims[0].contacts() == Contacts(base=0, arm=0)
    assert world.sims[0].touched() == Touched(frozenset(), frozenset())


def test_a_base_that_runs_backwards_into_a_wall_touches_it(world, begin):
    begin(x=-2.3)
    stay(world, 150, twist(-0.2))
    wall = world.sims[0].furniture.link("wall", "wall")
    assert world.sims[0].contacts().base > 0
    assert world.sims[0].touched() == Touched(frozenset(wall[:1]), frozenset())
    assert contacts(world.sims[0].body, [wall]) == Contacts(base=0, arm=0)


def test_an_arm_that_reaches_into_a_wall_touches_it(world, begin, between_fingers):
    pose = np.array([*between_fingers[:2], 0.0, 0.0, 0.0, 0.0, 1.0])
    begin(wall=pose)
    stay(world, 2)
    assert world.sims[0].contacts().arm > 0
    assert world.sims[0].furniture.bodies["wall"] in world.sims[0].touched().arm
