import pytest

from kinfeas.sim.physics import ROOT
from tests.sim.conftest import stay


def test_opens_and_closes(world, begin):
    begin()
    assert 0.3 <= world.gripper.opening <= 0.7
    world.gripper.open()
    stay(world, 75)
    assert world.gripper.opening == pytest.approx(1.0, abs=1e-3)
    world.gripper.close()
    stay(world, 150)
    assert world.gripper.opening == pytest.approx(0.0, abs=1e-3)


def test_closes_round_what_is_between_the_fingers(world, begin, between_fingers):
    begin(bar=between_fingers)
    bar = world.furniture.bodies["bar"]
    world.gripper.close()
    touched = set()
    world.physics.client.setGravity(0.0, 0.0, 0.0)
    for _ in range(40):
        stay(world, 1)
        touched |= {world.gripper.touching(bar, ROOT)}
    world.physics.client.setGravity(0.0, 0.0, -9.81)
    assert frozenset({0, 1}) in touched
    assert world.gripper.opening > 0.1
    assert world.gripper.touching(world.furniture.bodies["wall"], ROOT) == frozenset()
