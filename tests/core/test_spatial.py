import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import (
    IDENTITY,
    compose,
    distance,
    from_columns,
    integrate,
    planar_offset,
    planar_pose,
    relative,
    rotation,
    twist_between,
    wrap,
    yaw,
)
from tests.builders import assert_near, random_poses

SHAPES = [(), (3,), (2, 3)]


@pytest.fixture(params=SHAPES)
def drawn(request):
    """Three poses or arrays of poses."""
    return random_poses((3, *request.param), reach=5.0)


def assert_same(a, b):
    assert np.shape(a) == np.shape(b)
    assert_near(a, b, 1e-9, 1e-9)


def test_compose_is_associative_and_relative_undoes_it(drawn):
    a, b, c = drawn
    assert_same(compose(compose(a, b), c), compose(a, compose(b, c)))
    assert_same(relative(compose(a, b), a), b)
    assert_same(compose(b, relative(a, b)), a)
    none = np.broadcast_to(IDENTITY, a.shape)
    assert_same(relative(a, a), none)
    assert_same(compose(none, a), a)


@pytest.mark.parametrize("dt", [0.01, 1.0, 10.0])
def test_twist_between_and_integrate_are_inverse(drawn, dt):
    a, b, _ = drawn
    assert_same(integrate(a, twist_between(a, b, dt), dt), b)
    twist = np.clip(b[..., :6], -1.7, 1.7) / dt
    np.testing.assert_allclose(
        dt * twist_between(a, integrate(a, twist, dt), dt), dt * twist, atol=1e-7
    )


def test_distance_is_symmetric_and_the_same_in_every_frame(drawn):
    a, b, frame = drawn
    between = np.array(distance(a, b))
    assert between.shape == (2, *a.shape[:-1])
    np.testing.assert_allclose(between, distance(b, a), atol=1e-9)
    np.testing.assert_allclose(between, distance(compose(frame, a), compose(frame, b)), atol=1e-7)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_pose_is_canonical(shape):
    a, b = random_poses(shape, 1), random_poses(shape, 2)
    x, y, angle = np.random.default_rng(0).uniform(-9.0, 9.0, (3, *shape))
    planar = planar_pose(x, y, angle)
    for pose in (compose(a, b), relative(a, b), integrate(a, b[..., :6], 0.7), planar):
        assert np.all(pose[..., 6] >= 0.0)
        np.testing.assert_allclose(np.linalg.norm(pose[..., 3:], axis=-1), 1.0)
    np.testing.assert_allclose(planar[..., :3], np.stack([x, y, np.zeros(shape)], -1))
    np.testing.assert_allclose(yaw(planar), wrap(angle))
    np.testing.assert_allclose(rotation(planar).as_rotvec()[..., 2], wrap(angle))


def test_twists_are_along_the_axes_of_the_world():
    quarter = integrate(planar_pose(0.0, 0.0, np.pi / 2), np.array([1.0, 0, 0, 0, 0, 0]), 1.0)
    ahead = integrate(quarter, np.array([0.2, 0.0, 0.0, 0.0, 0.0, np.pi / 4]), 2.0)
    np.testing.assert_allclose(ahead[:3], [1.4, 0.0, 0.0], atol=1e-12)
    assert yaw(ahead) == pytest.approx(np.pi)


@pytest.mark.parametrize("shape", SHAPES)
def test_two_columns_need_not_be_orthonormal(shape):
    poses = random_poses(shape, 1)
    first, second, _ = np.moveaxis(rotation(poses).as_matrix(), -1, 0)
    values = np.concatenate([poses[..., :3], 3.0 * first, 0.1 * second - first], axis=-1)
    np.testing.assert_allclose(from_columns(values), poses, atol=1e-9)


def test_planar_offset_is_zero_for_unknown_poses():
    pose, frame = planar_pose(*np.random.default_rng(0).uniform(-9.0, 9.0, (3, 2, 5)))
    child = relative(pose, frame)
    expected = np.column_stack([child[:, :2], yaw(child)])
    np.testing.assert_allclose(planar_offset(pose, frame), expected, atol=1e-12)
    pose[2] = np.nan
    expected[2] = 0.0
    np.testing.assert_allclose(planar_offset(pose, frame), expected, atol=1e-12)


def test_wrap_ends_within_half_a_turn_of_zero():
    seams = np.pi * np.array([-3.0, -1.0, 1.0, 3.0])
    np.testing.assert_allclose(wrap(seams), np.pi)
    beside = [np.nextafter(seams, toward) for toward in (-9.0, 9.0)]
    angle = np.concatenate([np.random.default_rng(0).uniform(-1e4, 1e4, 500), *beside])
    wrapped = wrap(angle)
    assert np.all((-np.pi < wrapped) & (wrapped <= np.pi))
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angle), atol=1e-9)


@pytest.mark.parametrize("shape", [(), (3,), (6,), (8,), (7, 1), (0,), (0, 6)])
@pytest.mark.parametrize("function", [compose, relative, distance, lambda *p: twist_between(*p, 1)])
def test_other_shapes_raise_errors(function, shape):
    wrong, pose = np.ones(shape), np.broadcast_to(IDENTITY, (*shape[:-1], 7))
    for arguments in ((wrong, pose), (pose, wrong), (wrong, wrong)):
        with pytest.raises(KinfeasError, match="poses"):
            function(*arguments)
    with pytest.raises(KinfeasError, match="broadcast"):
        function(np.tile(IDENTITY, (2, 1)), np.tile(IDENTITY, (3, 1)))
    with pytest.raises(KinfeasError, match="poses"):
        yaw(wrong)
    with pytest.raises(KinfeasError, match="twist"):
        integrate(IDENTITY, IDENTITY, 0.1)
