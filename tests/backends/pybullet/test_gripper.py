import pytest

from kinfeas.backends.pybullet.physics import ROOT
from tests.backends.pybullet.conftest import stay


def test_opens_and_closes(world, begin):
    begin()
    assert 0.3 <= world.sims[0].gripper.opening <= 0.7
    world.sims[0].gripper.open()
    stay(world, 75)
    assert world.sims[0].gripper.opening == pytest.approx(1.0, abs=1e-3)
    world.sims[0].gripper.close()
    stay(world, 150)
    assert world.sims[0].gripper.opening == pytest.approx(0.0, abs=1e-3)


def test_closes_round_what_is_between_the_fingers(world, begin, between_fingers):
    begin(bar=between_fingers)
    bar = world.sims[0].furniture.bodies["bar"]
    world.sims[0].gripper.close()
    touched = set()
    world.sims[0].physics.client.setGravity(0.0, 0.0, 0.0)
    for _ in range(40):
        stay(world, 1)
        touched |= {world.sims[0].gripper.touching(bar, ROOT)}
    world.sims[0].physics.client.setGravity(0.0, 0.0, -9.81)
    assert frozenset({0, 1}) in touched
    assert world.sims[0].gripper.opening > 0.1
    assert (
        world.sims[0].gripper.touching(world.sims[0].furniture.bodies["wall"], ROOT) == frozenset()
    )
