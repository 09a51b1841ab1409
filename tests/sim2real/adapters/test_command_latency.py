import numpy as np
import pytest

from kinfeas.sim2real.adapters.command_latency import CommandLatency


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


def test_a_fraction_of_a_period_is_the_mean_by_time(rig, drive):
    late, twists, sent = rig(CommandLatency, seconds=0.06), drive(20), targets(20)
    late.run(twists, 0.1, sent)
    expected = 0.6 * twists[:-1] + 0.4 * twists[1:]
    np.testing.assert_allclose(late.passed[1:], expected, atol=1e-12)
    np.testing.assert_allclose(late.sent[1:], 0.6 * sent[:-1] + 0.4 * sent[1:], atol=1e-12)
    np.testing.assert_allclose(late.passed[0], 0.4 * twists[0], atol=1e-12)


@pytest.mark.parametrize("seconds", [0.06, 0.1, 0.23])
def test_it_is_the_same_latency_at_another_rate(rig, seconds):
    """A command that holds for 0.1 s moves the base as far, and as late, at 10 and 50 Hz."""
    coarse, fine = rig(CommandLatency, seconds=seconds), rig(CommandLatency, seconds=seconds)
    twists = np.random.default_rng(0).normal(size=(20, 1, 6))
    coarse.run(twists, 0.1)
    fine.run(np.repeat(twists, 5, axis=0), 0.02)
    means = fine.passed.reshape(20, 5, 1, 6).mean(axis=1)
    np.testing.assert_allclose(coarse.passed, means, atol=1e-12)


def test_the_rate_may_change_on_the_way(rig):
    late = rig(CommandLatency, seconds=0.1)
    ones = np.ones((1, 6))
    late.run([ones, 2 * ones], 0.1)
    late.run([3 * ones, 4 * ones, 5 * ones, 6 * ones, 7 * ones, 8 * ones], 0.02)
    expected = [0, 1, 2, 2, 2, 2, 2, 3]
    np.testing.assert_allclose(late.passed[:, 0, 0], expected, atol=1e-9)


def test_jitter_keeps_to_its_range_and_to_the_order(rig):
    late = rig(CommandLatency, n=50, seconds=0.04, jitter=0.1)
    ramp = np.arange(100.0)[:, np.newaxis, np.newaxis] * np.ones((1, 6))
    late.run(ramp, 0.02)
    # Command k is sent at 0.02 k: what is in force tells how old it is.
    age = 0.02 * (np.arange(100)[:, np.newaxis] - late.passed[..., 0])[10:]
    assert 0.02 <= age.min() < 0.05
    assert 0.06 < age.max() <= 0.14 + 0.02
    assert np.diff(late.passed[..., 0], axis=0).min() >= -1e-9


def test_continuous_joints_take_the_short_way(rig):
    late = rig(CommandLatency, seconds=0.05)
    near = np.zeros((2, 1, 7))
    near[0, 0, 4], near[1, 0, 4] = 3.1, -3.1
    late.run(np.zeros((2, 6)), 0.1, near)
    assert abs(late.sent[1, 0, 4]) == pytest.approx(np.pi, abs=1e-9)
