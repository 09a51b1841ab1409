from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance, make_pose
from kinfeas.scenes.exercise import EXERCISES, load_exercise


@pytest.fixture(params=EXERCISES)
def name(request):
    return request.param


def test_the_handle_is_where_the_task_has_it(name):
    path = Path(__file__).parents[2] / "kinfeas" / "tasks" / f"{name}.yaml"
    place = strict_yaml.read(path)["places"]["handle"]
    expected = make_pose(np.array(place["position"]), Rotation.from_euler("xyz", place["rpy"]))
    metres, radians = distance(load_exercise(name).handle, expected)
    assert metres == 0.0
    assert radians < 1e-9


def test_the_mechanism_is_the_method_s(name):
    joint = load_exercise(name).joint
    assert joint.kind == {"door": "hinge", "drawer": "slide"}[name]
    assert joint.limits == {"door": (0.0, 1.92), "drawer": (0.0, 0.35)}[name]
    assert joint.axis == {"door": (0.0, 0.0, 1.0), "drawer": (1.0, 0.0, 0.0)}[name]
    if name == "door":
        assert joint.origin == (0.185, 2.829, 0.65)


def test_an_unknown_mechanism_is_named():
    with pytest.raises(KinfeasError, match=r"unknown mechanism 'dor'.*'door'"):
        load_exercise("dor")


def test_outlines_are_those_of_the_furniture():
    door, drawer = load_exercise("door"), load_exercise("drawer")
    np.testing.assert_allclose(door.body, [[-0.2075, 2.83], [0.2075, 3.195]], atol=1e-9)
    np.testing.assert_allclose(door.part, [[-0.135, 2.829], [0.175, 2.845]], atol=1e-9)
    np.testing.assert_allclose(drawer.body, [[-3.195, -0.2075], [-2.83, 0.2075]], atol=1e-9)
    np.testing.assert_allclose(drawer.part, [[-3.17, -0.185], [-2.83, 0.185]], atol=1e-9)
