import numpy as np
import pytest

from kinfeas.core.spatial import IDENTITY, planar_pose
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.check import Solids

SIZES = {"box": (0.2, 0.2, 0.2), "cylinder": (0.1, 0.2), "sphere": (0.1,)}


def at(kind, x):
    return Shape(kind, SIZES[kind], planar_pose(np.array(x), np.array(0.0), np.array(0.0)))


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("other", SIZES)
def test_shapes_touch_from_where_their_surfaces_meet(kind, other):
    assert Solids([at(kind, 0.199)]).touches(Solids([at(other, 0.0)]))
    assert not Solids([at(kind, 0.201)]).touches(Solids([at(other, 0.0)]))


@pytest.mark.parametrize("kind", SIZES)
def test_two_smaller_groups_allow_for_an_overlap(kind):
    assert not Solids([at(kind, 0.1992)], 1e-3).touches(Solids([at(kind, 0.0)], 1e-3))
    assert Solids([at(kind, 0.1985)], 1e-3).touches(Solids([at(kind, 0.0)], 1e-3))


def test_a_group_touches_with_any_of_its_shapes_and_moves():
    group = Solids([at("box", 0.0), at("sphere", 5.0)])
    probe = Solids([at("box", 5.1)])
    assert group.touches(probe)
    group.place(np.tile(np.eye(3), (2, 1, 1)), np.array([[0.0, 0.0, 0.0], [7.0, 0.0, 0.0]]))
    assert not group.touches(probe)
    assert not Solids([]).touches(probe)


def test_what_is_thinner_than_the_allowance_stays():
    sheet = Shape("box", (1.0, 1.0, 5e-4), IDENTITY)
    assert Solids([sheet], 1e-3).touches(Solids([at("box", 0.0)], 1e-3))
