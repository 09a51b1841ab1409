import numpy as np
import pytest

from kinfeas.core.spatial import yaw
from kinfeas.sim2real.adapters.timing import CommandLatency, DroppedCommands, SensorLatency


def targets(steps, seed=0):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (steps, 1, 7))


@pytest.mark.parametrize(("seconds", "dt"), [(0.1, 0.1), (0.3, 0.1), (0.06, 0.02), (0.06, 0.03)])
def test_whole_periods_delay_by_as_many_steps_to_the_bit(rig, drive, seconds, dt):
    late, twists, sent = rig(CommandLatency, seconds=seconds), drive(60), targets(60)
    late.run(twists, dt, sent)
    k = round(seconds / dt)
    np.testing.assert_array_equal(late.passed[k:], twists[: 60 - k])
    np.testing.assert_array_equal(late.sent[k:], sent[: 60 - k])
    np.testing.assert_array_equal(late.passed[:k], 0.0)
    np.testing.assert_array_equal(late.sent[:k, 0], np.broadcast_to(late.joints, (k, 7)))
    late = rig(SensorLatency, seconds=seconds)
    states = late.run(twists, dt, sent)
    for now, before in zip(states[k:], states, strict=False):
        np.testing.assert_array_equal(now.base_pose, before.true_state.base_pose)
        np.testing.assert_array_equal(now.joint_positions, before.true_state.joint_positions)
        assert now.age == pytest.approx(seconds)
    for now in states[:k]:
        np.testing.assert_array_equal(now.base_pose, late.first.base_pose)
        np.testing.assert_array_equal(now.joint_positions, late.joints)


@pytest.mark.parametrize("seconds", [0.06, 0.1, 0.23])
def test_it_is_the_same_latency_at_another_rate(rig, seconds):
    """A command that holds for 0.1 s moves the base as far, and as late, at 10 and 50 Hz."""
    coarse, fine = rig(CommandLatency, seconds=seconds), rig(CommandLatency, seconds=seconds)
    twists = np.random.default_rng(0).normal(size=(20, 1, 6))
    coarse.run(twists, 0.1)
    fine.run(np.repeat(twists, 5, axis=0), 0.02)
    means = fine.passed.reshape(20, 5, 1, 6).mean(axis=1)
    np.testing.assert_allclose(coarse.passed, means, atol=1e-12)
    near = np.zeros((2, 1, 7))  # continuous joints take the short way
    near[:, 0, 4] = 3.1, -3.1
    late = rig(CommandLatency, seconds=0.05)
    late.run(np.zeros((2, 6)), 0.1, near)
    assert abs(late.sent[1, 0, 4]) == pytest.approx(np.pi, abs=1e-9)


def test_jitter_keeps_to_its_range_and_to_the_order(rig):
    late = rig(CommandLatency, n=50, seconds=0.04, jitter=0.1)
    ramp = np.arange(100.0)[:, np.newaxis, np.newaxis] * np.ones((1, 6))
    late.run(ramp, 0.02)
    # Command k is sent at 0.02 k: what is in force tells how old it is.
    age = 0.02 * (np.arange(100)[:, np.newaxis] - late.passed[..., 0])[10:]
    assert 0.02 <= age.min() < 0.05
    assert 0.06 < age.max() <= 0.14 + 0.02
    assert np.diff(late.passed[..., 0], axis=0).min() >= -1e-9


def test_late_readings_are_interpolated_and_never_show_an_older_robot(rig):
    late = rig(SensorLatency, n=40, seconds=0.02, jitter=0.2)
    states = late.run(np.tile([1.0, 0, 0, 0, 0, 0.5], (60, 1)), 0.05)
    x = np.stack([state.base_pose[:, 0] for state in states])
    assert np.diff(x, axis=0).min() >= 0.0
    age = np.stack([state.age for state in states])[10:]
    assert age.min() >= 0.02
    assert 0.1 < age.max() <= 0.22 + 0.05
    for state in states[10:]:
        true = state.true_state.base_pose
        np.testing.assert_allclose((true - state.base_pose)[:, 0], state.age, atol=1e-9)
        turned = yaw(true) - yaw(state.base_pose)
        np.testing.assert_allclose(turned, 0.5 * state.age, atol=1e-9)


def test_after_a_lost_command_the_last_one_is_active(rig, drive):
    lossy = rig(DroppedCommands, n=30, probability=0.3)
    twists = drive(200, n=30)
    lossy.run(twists)
    came = np.all(lossy.passed == twists, axis=2)
    assert came.mean() == pytest.approx(0.7, abs=0.03)
    held = np.concatenate([np.zeros((1, 30, 6)), lossy.passed[:-1]])
    np.testing.assert_array_equal(lossy.passed[~came], held[~came])
