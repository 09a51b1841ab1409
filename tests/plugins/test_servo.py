import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinfeas.core import spatial
from kinfeas.plugins.servo import Servo
from tests.builders import assert_near, random_poses

LIMITS = {
    "max_velocity": 0.2, "max_acceleration": 2.0, "max_jerk": 60.0,
    "max_angular_velocity": 0.5, "max_angular_acceleration": 6.0, "max_angular_jerk": 150.0,
}  # fmt: skip


def follow(motion, pose, targets, dt):
    """Return poses (t, n, 7) and velocities (t, n, 6) at the ends of steps toward targets."""
    state, paths, velocities = motion.start(pose, targets[0], []), [], []
    for target, seconds in zip(targets, dt, strict=True):
        twist, state = motion.twist(state, pose, target, seconds)
        pose = spatial.integrate(pose, twist, seconds)
        paths.append(pose)
        velocities.append(state["velocity"])
    return np.array(paths), np.array(velocities)


@given(seed=st.integers(0, 2**32 - 1), hold=st.integers(1, 20))
@settings(max_examples=25, deadline=None)
def test_velocity_acceleration_and_jerk_stay_within_their_limits(seed, hold):
    """Also where targets jump, and where each row slows down by itself."""
    n, steps, dt = 20, 100, 1e-3
    start, *targets = random_poses((steps + 1, n), seed)
    targets = np.repeat(targets, hold, axis=0)[:steps]
    _, velocity = follow(Servo(**LIMITS), start, targets, np.full((steps, n), dt))
    velocity = np.concatenate([np.zeros((2, n, 6)), velocity])
    for part, kind in ((velocity[..., :3], ""), (velocity[..., 3:], "angular_")):
        for order, name in enumerate(("velocity", "acceleration", "jerk")):
            size = np.linalg.norm(np.diff(part, order, axis=0), axis=2) / dt**order
            assert size.max() <= LIMITS[f"max_{kind}{name}"] * (1.0 + 1e-6), name


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_an_ee_stays_within_a_box_of_targets_and_reaches_the_last_one(seed):
    n, steps = 10, 600
    start, *targets = random_poses((7, n), seed)
    targets = np.repeat(targets, steps // 6, axis=0)
    targets[steps // 3 :] = targets[-1]
    dt = np.random.default_rng(seed).uniform(0.001, 0.3, (steps, n))
    paths, _ = follow(Servo(**LIMITS), start, targets, dt)
    box = np.concatenate([start[np.newaxis], targets])
    assert np.all(paths[..., :3] >= box.min(axis=0)[:, :3] - 1e-9)
    assert np.all(paths[..., :3] <= box.max(axis=0)[:, :3] + 1e-9)
    assert_near(paths[-1], targets[-1], 1e-4, 1e-3)


def test_a_motion_does_not_depend_on_the_control_rate():
    """A command that both rates limit to the same velocity leads to the same pose."""
    start = random_poses(5)
    target = start + np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    ends = [
        follow(Servo(**LIMITS), start, np.array([target] * n), np.full((n, 5), 1.0 / n))[0][-1]
        for n in (10, 50)
    ]
    np.testing.assert_allclose(*ends, atol=1e-9)


@pytest.mark.parametrize("lookahead", [0.0, 2.0])
def test_the_goal_lies_ahead_of_a_moving_target(lookahead):
    motion, pose = Servo(**LIMITS, lookahead=lookahead), spatial.IDENTITY[np.newaxis]
    target = pose + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    state = motion.start(pose, target, [])
    for _ in range(10):
        twist, state = motion.twist(state, pose, target, np.array([0.1]))
    ahead = motion.goal_pose(state, target)[0, 0] - 1.0
    assert ahead == pytest.approx(twist[0, 0] * lookahead, abs=1e-3)
