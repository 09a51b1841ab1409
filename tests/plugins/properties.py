"""What every motion along a path has to do, whatever its path comes from."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import compose, integrate, make_pose
from kinfeas.testing import check_motion_generator
from tests.plugins.conftest import DT, apart, random_poses, run, speeds


def starts_and_targets(n, seed):
    """Return starts up to 3 m away from the targets, and the targets, turned any way."""
    targets, away = random_poses(n, seed), random_poses(n, seed + 1, reach=3.0)
    away[:, :3] += targets[:, :3]
    return away, targets


def check_everything(generator, duration=100.0):
    """Check contract, arrival, limits and that no row depends on the batch."""
    check_motion_generator(generator)
    check_arrival(generator, duration)
    check_arrival(generator, duration, n=10, dt=0.5)  # a rate at which springs may ring
    check_rows(generator)
    check_mixed_steps(generator)
    check_no_motions(generator)


def check_arrival(generator, duration, n=300, dt=DT):
    start, target = starts_and_targets(n, 0)
    poses, twists, state = run(generator, start, target, duration, dt)
    metres, radians = apart(poses[-1], generator.goal_pose(state, target))
    assert max(metres.max(), radians.max()) < 1e-6
    linear, angular = speeds(twists)
    assert max(linear.max(), angular.max()) <= 0.1 * (1.0 + 1e-9)
    assert np.abs(twists[-1]).max() < 1e-6


def check_rows(generator):
    start, target = starts_and_targets(23, 3)
    poses, twists, _ = run(generator, start, target, 20.0)
    for rows in (slice(0, 1), slice(22, 23), slice(3, 17), slice(0, 23, 3)):
        some_poses, some_twists, _ = run(generator, start[rows], target[rows], 20.0)
        assert np.array_equal(some_poses, poses[:, rows])
        assert np.array_equal(some_twists, twists[:, rows])


def check_mixed_steps(generator, steps=100):
    """Check that a motion does not depend on how long the steps of the others are."""
    start, target = starts_and_targets(6, 5)
    dt = np.array([0.1, 0.02, 0.1, 0.5, 0.02, 0.1])
    state, poses = generator.start(start, target, [None] * 6), [start]
    for _ in range(steps):
        twist, state = generator.twist(state, poses[-1], target, dt)
        poses.append(integrate(poses[-1], twist, dt))
    for row, seconds in enumerate(dt.tolist()):
        one = slice(row, row + 1)
        alone, _, after = run(generator, start[one], target[one], steps * seconds, seconds)
        assert np.array_equal(alone[:, 0], np.stack(poses)[:, row])
        assert all(np.array_equal(after[key][0], values[row]) for key, values in state.items())


def check_no_motions(generator):
    none = np.zeros((0, 7))
    twist, state = generator.twist(
        generator.start(none, none, []), none, none, np.full(len(none), DT)
    )
    assert twist.shape == (0, 6)
    assert generator.goal_pose(state, none).shape == (0, 7)


def check_moves_with_target(generator):
    start, target = starts_and_targets(6, 7)
    turn = make_pose(np.array([1.0, -2.0, 0.3]), Rotation.random(rng=3))
    moved = np.repeat(turn[np.newaxis], 6, axis=0)
    here, _, _ = run(generator, start, target, 30.0)
    there, _, _ = run(generator, compose(moved, start), compose(moved, target), 30.0)
    metres, radians = apart(there, compose(moved, here))
    assert metres.max() < 1e-8
    assert radians.max() < 1e-6


def check_numbers(make, names):
    """Check that each of the parameters `names` has to be a positive number."""
    for name in names:
        for value in (0.0, -0.1, np.nan, "fast", True):
            with pytest.raises(KinfeasError, match=f"^{name} must be a positive number, not "):
                make(**{name: value})
