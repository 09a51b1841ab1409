import numpy as np
import pytest

from kinfeas.sim2real.link import JointPath
from kinfeas.sim2real.simulator.joint_setpoints import JointSetpoints


def path(joints, *points):
    """Return a way of (time, positions)."""
    times, positions = zip(*points, strict=True)
    return JointPath(joints, np.array(times), np.array(positions, dtype=float))


def test_holds_until_it_is_told():
    setpoints = JointSetpoints({"a": 0.5, "b": -1.0})
    assert setpoints.at(0.0) == setpoints.at(1e9) == {"a": 0.5, "b": -1.0}


def test_passes_the_points_in_order_and_holds_the_last():
    setpoints = JointSetpoints({"a": 0.0, "b": 4.0})
    setpoints.follow(path(("b", "a"), (1.0, [4.0, 1.0]), (3.0, [0.0, -1.0])), 10.0)
    for time, a, b in ((10.0, 0.0, 4.0), (10.5, 0.5, 4.0), (11.0, 1.0, 4.0), (12.0, 0.0, 2.0)):
        assert setpoints.at(time) == pytest.approx({"a": a, "b": b})
    assert setpoints.at(13.0) == setpoints.at(99.0) == {"a": -1.0, "b": 0.0}


def test_a_new_way_begins_where_the_joint_is_wanted_then():
    setpoints = JointSetpoints({"a": 0.0})
    setpoints.follow(path(("a",), (2.0, [2.0])), 0.0)
    setpoints.follow(path(("a",), (1.0, [0.0])), 1.0)
    assert setpoints.at(1.0)["a"] == pytest.approx(1.0)
    assert setpoints.at(1.5)["a"] == pytest.approx(0.5)
    assert setpoints.at(2.0)["a"] == 0.0


def test_other_joints_go_their_own_way():
    setpoints = JointSetpoints({"a": 0.0, "b": 0.0})
    setpoints.follow(path(("a",), (2.0, [2.0])), 0.0)
    setpoints.follow(path(("b", "nobody"), (0.0, [1.0, 5.0])), 1.0)
    assert setpoints.at(1.5) == pytest.approx({"a": 1.5, "b": 1.0})
