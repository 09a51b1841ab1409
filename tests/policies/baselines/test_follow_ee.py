import numpy as np
import pytest

from kinfeas.control.drive import action_size, base_twist
from kinfeas.control.observation import HORIZON
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import integrate, planar_pose
from kinfeas.policies.baselines.follow_ee import FollowEe


def policy_input(velocity, lag=(0.0, 0.0), heading=0.7):
    """Return what policies see where the EE is to move at `velocity` and lags behind by `lag`."""
    velocity = np.atleast_2d(velocity)
    n = len(velocity)
    desired = np.tile([0.5, 0.1, 0.8, 0.0, 0.0, 0.0, 1.0], (n, 1))
    twist = np.zeros((n, 6))
    twist[:, :2], twist[:, 2] = velocity, 0.05
    ee = desired.copy()
    ee[:, :2] -= lag
    base = planar_pose(np.ones(n), np.zeros(n), np.full(n, heading))
    planned = integrate(desired, twist, HORIZON)
    return PolicyInput(np.empty((n, 0)), base, ee, desired, planned, np.full((n, 7), np.nan))


def drive(robot, policy, seen):
    return base_twist(robot.base, seen.base_pose, policy.act(seen), HORIZON)


@pytest.mark.parametrize("feedback", [False, True])
def test_copies_the_planar_velocity(robot, feedback):
    along = np.array([np.cos(0.7), np.sin(0.7)]) * 0.08
    twist = drive(robot, FollowEe(robot.base, feedback), policy_input(along))
    np.testing.assert_allclose(twist[0], [*along, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_omnidirectional_bases_do_not_rotate(robot):
    velocity = np.random.default_rng(0).uniform(-0.1, 0.1, (50, 2))
    twist = drive(robot, FollowEe(robot.base), policy_input(velocity))
    if robot.base.drive == "omnidirectional":
        np.testing.assert_allclose(twist[:, :2], velocity, atol=1e-12)
        np.testing.assert_array_equal(twist[:, 5], 0.0)
    else:
        assert np.abs(twist[:, 5]).max() > 0.1


def test_only_feedback_catches_up(robot):
    lag = np.array([np.cos(0.7), np.sin(0.7)]) * 0.005
    seen = policy_input([[0.0, 0.0]], lag)
    np.testing.assert_allclose(drive(robot, FollowEe(robot.base), seen), 0.0, atol=1e-12)
    twist = drive(robot, FollowEe(robot.base, feedback=True), seen)
    np.testing.assert_allclose(twist[0, :2], lag / HORIZON, atol=1e-12)


@pytest.mark.parametrize("feedback", [False, True])
def test_stays_within_bounds(robot, feedback):
    velocity = np.random.default_rng(1).normal(scale=2.0, size=(200, 2))
    action = FollowEe(robot.base, feedback).act(policy_input(velocity, (0.3, -1.0)))
    assert action.shape == (200, action_size(robot.base))
    assert np.abs(action).max() <= 1.0
