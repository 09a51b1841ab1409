import numpy as np
import pytest

from kinfeas.core.spatial import integrate, planar_pose, yaw
from kinfeas.kinematics.drive import action_toward, base_twist, command_size
from kinfeas.robots.robot import Base
from tests.builders import random_bases

OMNI = Base("omnidirectional", 0.2, 1.0, 1.0, 1.0, "base")
DIFFERENTIAL = Base("differential", 0.2, 0.4, 1.0, 1.0, "base")
DT = 0.1


def headings(*angles):
    angles = np.array(angles, dtype=float)
    return planar_pose(np.full(angles.shape, 1.0), np.full(angles.shape, -2.0), angles)


def random_actions(base, n, seed=1):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (n, command_size(base)))


@pytest.mark.parametrize(("heading", "action", "expected"), [
    (np.pi / 2, (0.5, 0.0, 1.0), (0.0, 0.1, 1.0)),
    (0.0, (0.0, 0.5, 0.0), (0.0, 0.1, 0.0)),
    (0.0, (0.6, 0.8, 0.0), (0.12, 0.16, 0.0)),
    (0.0, (1.0, -1.0, 0.0), (0.2 / np.sqrt(2.0), -0.2 / np.sqrt(2.0), 0.0)),  # by its norm
])  # fmt: skip
def test_omnidirectional_translates_with_the_old_heading_then_rotates(heading, action, expected):
    twist = base_twist(OMNI, headings(heading), np.array([action]), DT)
    np.testing.assert_allclose(twist[:, [0, 1, 5]], [expected], atol=1e-15)


def test_differential_rotates_then_drives_along_the_new_heading():
    twist = base_twist(DIFFERENTIAL, headings(0.3), np.array([[-0.5, 1.0]]), DT)
    new = 0.3 + 0.4 * DT
    expected = [[-0.1 * np.cos(new), -0.1 * np.sin(new), 0.0, 0.0, 0.0, 0.4]]
    np.testing.assert_allclose(twist, expected, atol=1e-15)


@pytest.mark.parametrize("dt", [0.02, 0.1, 1.0])
def test_differential_never_moves_sideways(dt):
    base = random_bases(500)
    moved = integrate(
        base, base_twist(DIFFERENTIAL, base, random_actions(DIFFERENTIAL, 500), dt), dt
    )
    way, heading = moved[:, :2] - base[:, :2], yaw(moved)
    sideways = way[:, 1] * np.cos(heading) - way[:, 0] * np.sin(heading)
    np.testing.assert_allclose(sideways, 0.0, atol=1e-14)


@pytest.mark.parametrize("base", [OMNI, DIFFERENTIAL])
def test_limits_hold_and_the_floor_is_kept(base):
    twist = base_twist(base, random_bases(500), random_actions(base, 500) * 3.0, DT)
    speed = np.linalg.norm(twist[:, :2], axis=1)
    assert speed.max() <= base.max_velocity * (1.0 + 1e-12)
    assert speed.max() > 0.99 * base.max_velocity
    assert np.abs(twist[:, 5]).max() <= base.max_rotation
    np.testing.assert_array_equal(twist[:, 2:5], 0.0)


def test_omnidirectional_action_toward_is_the_inverse():
    rng = np.random.default_rng(2)
    velocity = rng.uniform(-0.14, 0.14, (500, 2))
    base = random_bases(500)
    action = action_toward(OMNI, base, velocity, DT)
    twist = base_twist(OMNI, base, action, DT)
    np.testing.assert_allclose(twist[:, :2], velocity, atol=1e-14)
    np.testing.assert_array_equal(twist[:, 5], 0.0)


def test_differential_action_toward_is_the_inverse_where_its_drive_can():
    rng = np.random.default_rng(3)
    base = random_bases(500)
    turn = rng.uniform(-0.4, 0.4, 500) * DT  # as far as it can turn in one step
    direction = yaw(base) + turn + np.pi * rng.integers(2, size=500)
    speed = rng.uniform(0.01, 0.2, 500)
    velocity = speed[:, np.newaxis] * np.stack([np.cos(direction), np.sin(direction)], axis=1)
    twist = base_twist(DIFFERENTIAL, base, action_toward(DIFFERENTIAL, base, velocity, DT), DT)
    np.testing.assert_allclose(twist[:, :2], velocity, atol=1e-14)


def test_differential_steers_toward_what_lies_ahead_and_backs_up_to_what_lies_behind():
    velocity = np.array([[0.1, 0.1], [0.1, -0.1], [-0.1, 0.1], [-0.1, -0.1]])
    action = action_toward(DIFFERENTIAL, headings(0.0, 0.0, 0.0, 0.0), velocity, DT)
    np.testing.assert_array_equal(np.sign(action), [[1, 1], [1, -1], [-1, -1], [-1, 1]])
    # It drives by the part along the heading that it will have.
    turn = 0.4 * DT
    np.testing.assert_allclose(action[0], [0.1 * (np.cos(turn) + np.sin(turn)) / 0.2, 1.0])


@pytest.mark.parametrize("base", [OMNI, DIFFERENTIAL])
def test_action_toward_stays_within_bounds_and_stands_still_for_nothing(base):
    velocity = np.random.default_rng(4).normal(size=(500, 2))
    action = action_toward(base, random_bases(500), velocity, DT)
    assert action.shape == (500, command_size(base))
    assert np.abs(action).max() <= 1.0
    for zero in (0.0, -0.0):
        rest = action_toward(base, random_bases(9), np.full((9, 2), zero), DT)
        np.testing.assert_array_equal(rest, 0.0)
