import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import (
    IDENTITY,
    compose,
    distance,
    integrate,
    make_pose,
    planar_offset,
    planar_pose,
    relative,
    rotation,
    twist_between,
    wrap,
    yaw,
)
from tests.builders import random_poses

SHAPES = [(), (3,), (2, 3)]
shapes = st.sampled_from(SHAPES)


@st.composite
def poses(draw, shape):
    position = draw(arrays(float, (*shape, 3), elements=st.floats(-5.0, 5.0)))
    turn = draw(arrays(float, (*shape, 3), elements=st.floats(-1.8, 1.8)))
    return integrate(
        np.broadcast_to(IDENTITY, (*shape, 7)), np.concatenate([position, turn], -1), 1
    )


def assert_same(a, b, tolerance=1e-9):
    metres, radians = distance(a, b)
    assert np.shape(a) == np.shape(b)
    assert np.max(metres) < tolerance
    assert np.max(radians) < tolerance


@given(st.data(), shapes)
def test_compose_is_associative(data, shape):
    a, b, c = (data.draw(poses(shape)) for _ in range(3))
    assert_same(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(st.data(), shapes)
def test_relative_undoes_compose(data, shape):
    a, b = data.draw(poses(shape)), data.draw(poses(shape))
    assert_same(relative(compose(a, b), a), b)
    assert_same(compose(b, relative(a, b)), a)
    none = np.broadcast_to(IDENTITY, a.shape)
    assert_same(relative(a, a), none)
    assert_same(compose(none, a), a)


@given(st.data(), shapes, st.floats(0.01, 10.0))
def test_twist_between_leads_to_the_end(data, shape, dt):
    a, b = data.draw(poses(shape)), data.draw(poses(shape))
    assert_same(integrate(a, twist_between(a, b, dt), dt), b)


@given(st.data(), shapes, st.floats(0.01, 1.0))
def test_integrate_leads_along_the_twist(data, shape, dt):
    pose = data.draw(poses(shape))
    twist = data.draw(arrays(float, (*shape, 6), elements=st.floats(-1.7, 1.7)))
    assert np.allclose(twist_between(pose, integrate(pose, twist, dt), dt), twist, atol=1e-7)


@given(st.data(), shapes)
def test_distance_is_symmetric_and_the_same_in_every_frame(data, shape):
    a, b, frame = (data.draw(poses(shape)) for _ in range(3))
    metres, radians = distance(a, b)
    assert np.shape(metres) == np.shape(radians) == shape
    assert np.allclose([metres, radians], distance(b, a), atol=1e-9)
    moved = distance(compose(frame, a), compose(frame, b))
    assert np.allclose([metres, radians], moved, atol=1e-7)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_pose_is_canonical(shape):
    a, b = random_poses(shape, 1), random_poses(shape, 2)
    for pose in (compose(a, b), relative(a, b), integrate(a, b[..., :6], 0.7)):
        assert np.all(pose[..., 6] >= 0.0)
        assert np.allclose(np.linalg.norm(pose[..., 3:], axis=-1), 1.0)


def test_twists_are_along_the_axes_of_the_world():
    quarter = make_pose(np.array([1.0, 0.0, 0.0]), rotation(planar_pose(0.0, 0.0, np.pi / 2)))
    ahead = integrate(quarter, np.array([0.2, 0.0, 0.0, 0.0, 0.0, np.pi / 4]), 2.0)
    assert np.allclose(ahead[:3], [1.4, 0.0, 0.0])
    assert np.isclose(yaw(ahead), np.pi)


@pytest.mark.parametrize("shape", SHAPES)
def test_yaw_reads_planar_poses(shape):
    x, y, heading = np.random.default_rng(0).uniform(-9.0, 9.0, (3, *shape))
    pose = planar_pose(x, y, heading)
    assert pose.shape == (*shape, 7)
    assert np.allclose(pose[..., :3], np.stack([x, y, np.zeros(shape)], -1))
    assert np.all(pose[..., 6] >= 0.0)
    assert np.allclose(yaw(pose), wrap(heading))


def test_planar_offset_is_zero_for_unknown_poses():
    pose, frame = planar_pose(*np.random.default_rng(0).uniform(-9.0, 9.0, (3, 2, 5)))
    seen = relative(pose, frame)
    expected = np.column_stack([seen[:, :2], yaw(seen)])
    np.testing.assert_allclose(planar_offset(pose, frame), expected, atol=1e-12)
    pose[2] = np.nan
    expected[2] = 0.0
    np.testing.assert_allclose(planar_offset(pose, frame), expected, atol=1e-12)


@given(arrays(float, st.sampled_from(SHAPES), elements=st.floats(-1e4, 1e4)))
def test_wrap_ends_within_half_a_turn_of_zero(angle):
    wrapped = wrap(angle)
    assert np.shape(wrapped) == angle.shape
    assert np.all((-np.pi < wrapped) & (wrapped <= np.pi))
    assert np.allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-9)


@pytest.mark.parametrize("turns", [-3.0, -1.0, 1.0, 3.0])
@pytest.mark.parametrize("toward", [-9.0, 9.0])
def test_wrap_at_the_seam(turns, toward):
    assert wrap(turns * np.pi) == pytest.approx(np.pi)
    assert -np.pi < wrap(np.nextafter(turns * np.pi, toward)) <= np.pi


@pytest.mark.parametrize("shape", [(), (3,), (6,), (8,), (7, 1), (0,), (0, 6)])
@pytest.mark.parametrize("function", [compose, relative, distance, lambda *p: twist_between(*p, 1)])
def test_other_shapes_raise_errors(function, shape):
    wrong, pose = np.ones(shape), np.broadcast_to(IDENTITY, (*shape[:-1], 7))
    with pytest.raises(KinfeasError, match="poses"):
        yaw(wrong)
    for arguments in ((wrong, pose), (pose, wrong), (wrong, wrong)):
        with pytest.raises(KinfeasError, match="poses"):
            function(*arguments)
    with pytest.raises(KinfeasError, match="broadcast"):
        function(np.tile(IDENTITY, (2, 1)), np.tile(IDENTITY, (3, 1)))
    with pytest.raises(KinfeasError, match="twist"):
        integrate(IDENTITY, IDENTITY, 0.1)
