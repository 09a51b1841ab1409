"""The minimum-jerk motion follows the quintic, takes no longer than it must, and arrives."""

import numpy as np
import pytest

from kinfeas.core.spatial import IDENTITY, twist_between
from kinfeas.plugins.minimum_jerk import MinimumJerk
from tests.plugins.conftest import DT, apart, run, speeds
from tests.plugins.properties import (
    check_everything,
    check_moves_with_target,
    check_numbers,
    starts_and_targets,
)


def test_does_what_every_motion_has_to():
    check_everything(MinimumJerk())
    check_moves_with_target(MinimumJerk())


def test_follows_the_quintic():
    goal = np.array([[0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    poses, _, state = run(MinimumJerk(), IDENTITY[np.newaxis], goal, 10.0)
    assert state["duration"] == pytest.approx(1.875 * 0.4 / 0.1)
    s = np.minimum(np.arange(len(poses)) * DT / state["duration"], 1.0)
    expected = 0.4 * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    assert np.allclose(poses[:, 0, 0], expected, atol=1e-12)


def test_the_faster_of_both_limits_is_reached_halfway():
    start, target = starts_and_targets(50, 0)
    _, twists, _ = run(MinimumJerk(), start, target, 90.0)
    linear, angular = speeds(twists)
    assert np.allclose(np.maximum(linear, angular).max(axis=0), 0.1, rtol=1e-2)


def test_position_and_orientation_keep_in_step():
    start, target = starts_and_targets(20, 1)
    poses, _, _ = run(MinimumJerk(), start, target, 90.0)
    metres, radians = apart(poses, target)
    assert np.allclose(metres / metres[0], radians / radians[0], atol=1e-6)


def test_a_short_way_takes_the_shortest_time():
    goal = np.array([[1e-4, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    generator = MinimumJerk(min_duration=3.0)
    assert generator.start(IDENTITY[np.newaxis], goal, [])["duration"] == 3.0


def test_time_waits_for_a_hand_that_is_held_elsewhere():
    start, target = starts_and_targets(4, 2)
    generator = MinimumJerk()
    state = generator.start(start, target, [])
    held = start + np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(100):
        twist, state = generator.twist(state, held, target, np.full(len(held), DT))
    assert state["time"].max() < 0.5
    back = twist_between(held, start, 1.0)
    assert np.all(np.sum(twist[:, :3] * back[:, :3], axis=1) > 0.0)


def test_refuses_numbers_that_are_not_positive():
    check_numbers(MinimumJerk, ["min_duration", "max_velocity", "max_angular_velocity"])
