import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, distance, make_pose, rotation
from kinfeas.scenes.mechanism import AnalyticMechanism, MechanismJoint

HINGE = MechanismJoint("hinge", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 2.0), 0.5, 0.0, 0.0)
SLIDE = MechanismJoint("slide", (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.4), 2.0, 0.0, 0.0)
HANDLE = make_pose(np.array([0.0, 0.0, 0.6]), rotation(IDENTITY))
DT = 0.001


def joint(of, **changes):
    return config.from_mapping(MechanismJoint, {**config.to_mapping(of), **changes}, "test")


def pulled(of, force, seconds, start=0.0):
    """Return a mechanism that a constant force in the world has pulled at its handle."""
    mechanism = AnalyticMechanism(of, HANDLE)
    mechanism.position = start
    for _ in range(round(seconds / DT)):
        mechanism.pull(np.array(force), mechanism.handle_pose()[:3], DT)
    return mechanism


@pytest.mark.parametrize("of", [HINGE, SLIDE])
@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_a_closed_joint_leaves_everything_where_it_is(of, shape):
    carried = of.carry(HANDLE, np.zeros(shape))
    assert carried.shape == (*shape, 7)
    np.testing.assert_allclose(carried, np.broadcast_to(HANDLE, carried.shape), atol=1e-15)


@given(st.floats(-2.0, 2.0))
def test_a_hinge_turns_about_its_axis(angle):
    carried = HINGE.carry(HANDLE, angle)
    assert np.hypot(carried[0] - 1.0, carried[1]) == pytest.approx(1.0)
    assert carried[2] == pytest.approx(0.6)
    np.testing.assert_allclose(rotation(carried).as_rotvec(), [0.0, 0.0, angle], atol=1e-9)


@given(st.floats(-2.0, 2.0))
def test_a_slide_moves_along_its_axis(way):
    np.testing.assert_allclose(SLIDE.carry(HANDLE, way)[:3], [0.0, -way, 0.6], atol=1e-12)


@given(st.tuples(*[st.floats(-5.0, 5.0)] * 3), st.floats(-1.0, 1.0))
def test_effort_is_the_work_for_each_radian_or_metre(force, position):
    for of in (HINGE, SLIDE):
        here, step = of.carry(HANDLE, position), 1e-6
        there = of.carry(HANDLE, position + step)
        work = float(np.dot(force, (there - here)[:3]))
        assert of.effort(np.array(force), here[:3]) == pytest.approx(work / step, abs=1e-4)


def test_a_free_slide_accelerates_as_newton_says():
    assert pulled(SLIDE, [0.0, -1.0, 0.0], 1.0).position == pytest.approx(0.25, rel=2e-3)


def test_friction_holds_a_weaker_pull():
    sticky = joint(SLIDE, friction=1.0)
    assert pulled(sticky, [0.0, -0.999, 0.0], 1.0).position == 0.0
    assert pulled(sticky, [0.0, -1.2, 0.0], 1.0).position == pytest.approx(0.05, rel=1e-2)


def test_damping_ends_in_a_steady_speed():
    slow = joint(SLIDE, damping=10.0)
    positions = [pulled(slow, [0.0, -1.0, 0.0], seconds).position for seconds in (2.0, 3.0)]
    assert positions[1] - positions[0] == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(("force", "limit"), [(-9.0, 0.4), (9.0, 0.0)])
def test_a_limit_stops_it(force, limit):
    mechanism = pulled(SLIDE, [0.0, force, 0.0], 1.0, start=0.2)
    assert mechanism.position == limit
    mechanism.pull(np.array([0.0, -0.1 * force, 0.0]), HANDLE[:3], DT)
    assert mechanism.position != limit  # it lost its speed there, so it comes away at once


def test_a_pull_through_the_axis_does_not_open():
    assert pulled(HINGE, [-5.0, 0.0, 0.0], 0.5).position == 0.0
    assert distance(pulled(HINGE, [0.0, -1.0, 0.0], 0.5).handle_pose(), HANDLE)[0] > 0.1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "ball"}, "kind"),
        ({"axis": [0.0, 0.0, 2.0]}, "'axis' must be a unit vector"),
        ({"limits": [0.1, 1.0]}, "'limits' must go from"),
        ({"limits": [0.0, 0.0]}, "'limits' must go from"),
        ({"inertia": 0.0}, "inertia"),
        ({"friction": -1.0}, "friction"),
    ],
)
def test_bad_joints_are_refused(changes, message):
    with pytest.raises(KinfeasError, match=message):
        joint(HINGE, **changes)
