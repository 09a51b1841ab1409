import numpy as np
import pytest

from kinfeas.core.spatial import integrate, planar_pose, yaw
from kinfeas.kinematics.drive import action_toward, base_twist, command_size
from kinfeas.robots.robot import Base
from tests.builders import random_bases

OMNI = Base("omnidirectional", 0.2, 1.0, 1.0, 1.0, "base")
DIFFERENTIAL = Base("differential", 0.2, 0.4, 1.0, 1.0, "base")
DT, N = 0.1, 500


def headings(*angles):
    angles = np.array(angles, dtype=float)
    return planar_pose(np.full(angles.shape, 1.0), np.full(angles.shape, -2.0), angles)


@pytest.mark.parametrize(("heading", "action", "expected"), [
    (np.pi / 2, (0.5, 0.0, 1.0), (0.0, 0.1, 1.0)),
    (0.0, (0.0, 0.5, 0.0), (0.0, 0.1, 0.0)),
    (0.0, (0.6, 0.8, 0.0), (0.12, 0.16, 0.0)),
    (0.0, (1.0, -1.0, 0.0), (0.2 / np.sqrt(2.0), -0.2 / np.sqrt(2.0), 0.0)),  # by its norm
    (0.3, (-0.5, 1.0), (-0.1 * np.cos(0.34), -0.1 * np.sin(0.34), 0.4)),
])  # fmt: skip
def test_twists_of_actions(heading, action, expected):
    """An omnidirectional base has its old heading, a differential drive the new one."""
    base = OMNI if len(action) == 3 else DIFFERENTIAL
    twist = base_twist(base, headings(heading), np.array([action]), DT)
    np.testing.assert_allclose(twist[:, [0, 1, 5]], [expected], atol=1e-15)


@pytest.mark.parametrize("base", [OMNI, DIFFERENTIAL])
@pytest.mark.parametrize("dt", [0.02, 0.1, 1.0])
def test_limits_hold_and_a_differential_drive_never_moves_sideways(base, dt):
    poses = random_bases(N)
    action = np.random.default_rng(1).uniform(-4.5, 4.5, (N, command_size(base)))
    twist = base_twist(base, poses, action, dt)
    speed = np.linalg.norm(twist[:, :2], axis=1)
    assert 0.99 * base.max_velocity < speed.max() <= base.max_velocity * (1.0 + 1e-12)
    assert np.abs(twist[:, 5]).max() <= base.max_rotation
    np.testing.assert_array_equal(twist[:, 2:5], 0.0)
    velocity = np.random.default_rng(4).normal(size=(N, 2))
    assert np.abs(action_toward(base, poses, velocity, dt)).max() <= 1.0
    np.testing.assert_array_equal(action_toward(base, poses, -0.0 * velocity, dt), 0.0)
    if base is DIFFERENTIAL:
        moved = integrate(poses, twist, dt)
        step, heading = moved[:, :2] - poses[:, :2], yaw(moved)
        sideways = step[:, 1] * np.cos(heading) - step[:, 0] * np.sin(heading)
        np.testing.assert_allclose(sideways, 0.0, atol=1e-14)


@pytest.mark.parametrize("base", [OMNI, DIFFERENTIAL])
def test_action_toward_is_the_inverse_where_the_drive_can(base):
    rng, poses = np.random.default_rng(2), random_bases(N)
    direction = rng.uniform(-np.pi, np.pi, N)
    if base is DIFFERENTIAL:  # as far as it can turn in one step, ahead or behind
        turned = rng.uniform(-0.4, 0.4, N) * DT
        direction = yaw(poses) + turned + np.pi * rng.integers(2, size=N)
    speed = rng.uniform(0.01, 0.2, N)
    velocity = speed[:, np.newaxis] * np.stack([np.cos(direction), np.sin(direction)], axis=1)
    twist = base_twist(base, poses, action_toward(base, poses, velocity, DT), DT)
    np.testing.assert_allclose(twist[:, :2], velocity, atol=1e-14)
    if base is OMNI:
        np.testing.assert_array_equal(twist[:, 5], 0.0)


def test_a_differential_drive_steers_ahead_and_backs_up_to_a_velocity_behind_it():
    velocity = np.array([[0.1, 0.1], [0.1, -0.1], [-0.1, 0.1], [-0.1, -0.1]])
    action = action_toward(DIFFERENTIAL, headings(0.0, 0.0, 0.0, 0.0), velocity, DT)
    np.testing.assert_array_equal(np.sign(action), [[1, 1], [1, -1], [-1, -1], [-1, 1]])
    # It drives by the part along the heading that it will have.
    np.testing.assert_allclose(action[0], [0.1 * (np.cos(0.04) + np.sin(0.04)) / 0.2, 1.0])
