import numpy as np
import pytest

from kinfeas.control.execution import tool_pose
from kinfeas.core.spatial import compose
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from tests.backends.conftest import place, stay
from tests.builders import twist

FIRST = np.array([0])
STILL = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture
def begun(hsr, scene, opened):
    """A function that puts a bar on the edge of a chest, in the open hand or beside its middle."""
    x, y, z = compose(forward(IkSolver(hsr).chain, hsr.home["home"]), tool_pose(hsr))[:3]
    chest = np.array([x + 0.22, y, z - 0.3, *STILL])

    def build(name="bar", aside=0.0, *, handled=True):
        world = opened(hsr, scene)
        if handled:
            world.handle(name, "bar")
        bar = np.array([x, y + aside, z, *STILL])
        place(world, scene=scene.with_poses({name: bar, "chest": chest}))
        return world

    return build


def bar_of(world):
    return world.object_motion(0, "bar")[0]


def test_a_grasp_carries_an_object_until_it_is_opened(begun):
    world = begun()
    assert not world.holds(0, "bar")
    world.grip("close", FIRST)
    stay(world, 60)
    assert world.holds(0, "bar")
    assert not (world.touching(0).arm or world.touching(0).base)  # the grasped link does not count
    before = bar_of(world)
    stay(world, 150, twist(-0.1))
    np.testing.assert_allclose(bar_of(world)[:3] - before[:3], [-0.29, 0.0, 0.0], atol=0.02)
    world.grip("open", FIRST)
    assert not world.holds(0, "bar")
    stay(world, 60)
    assert bar_of(world)[2] < 0.2


def test_a_grasp_breaks_above_its_limit(begun):
    world = begun("post")
    world.grip("close", FIRST)
    stay(world, 60)
    assert world.holds(0, "post")
    stay(world, 150, twist(-0.1))  # the post is fixed
    assert not world.holds(0, "post")


def test_a_grasp_needs_both_fingers(begun):
    world = begun(aside=0.5)
    world.grip("close", FIRST)
    stay(world, 60)
    assert not world.holds(0, "bar")
    # At the first of these positions that one finger touches, the other is far away.
    near = (
        aside for aside in np.arange(0.0, 0.1, 0.004) if begun(aside=aside, handled=False).touched()
    )
    world = begun(aside=next(near))
    world.grip("close", FIRST)
    stay(world, 1)
    assert not world.holds(0, "bar")
    stay(world, 60)
    assert world.holds(0, "bar")
