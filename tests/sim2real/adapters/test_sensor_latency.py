import numpy as np
import pytest

from kinfeas.core.spatial import yaw
from kinfeas.sim2real.adapters.ee_noise import EeNoise
from kinfeas.sim2real.adapters.sensor_latency import SensorLatency


def targets(steps, seed=0):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (steps, 1, 7))


@pytest.mark.parametrize(("seconds", "dt"), [(0.1, 0.1), (0.3, 0.1), (0.06, 0.02), (0.06, 0.03)])
def test_whole_periods_show_what_was_as_many_steps_ago_to_the_bit(rig, drive, seconds, dt):
    late = rig(SensorLatency, seconds=seconds)
    seen = late.run(drive(60), dt, targets(60))
    k = round(seconds / dt)
    for now, before in zip(seen[k:], seen, strict=False):
        np.testing.assert_array_equal(now.base_pose, before.true_state.base_pose)
        np.testing.assert_array_equal(now.joint_positions, before.true_state.joint_positions)
        assert now.age == pytest.approx(seconds)
    for now in seen[:k]:
        np.testing.assert_array_equal(now.base_pose, late.first.base_pose)
        np.testing.assert_array_equal(now.joint_positions, late.joints)


def test_between_two_measurements_it_is_interpolated(rig):
    late = rig(SensorLatency, seconds=0.06)
    turning = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.5])
    for i, state in enumerate(late.run(np.tile(turning, (20, 1)), 0.1)):
        time = max(0.1 * (i + 1) - 0.06, 0.0)
        np.testing.assert_allclose(state.base_pose[0, 0], 0.1 * time, atol=1e-12)
        np.testing.assert_allclose(yaw(state.base_pose)[0], 0.5 * time, atol=1e-12)


def test_a_late_reading_never_shows_an_older_robot(rig):
    late = rig(SensorLatency, n=40, seconds=0.02, jitter=0.2)
    ahead = np.tile([1.0, 0, 0, 0, 0, 0], (60, 1))
    seen = late.run(ahead, 0.05)
    x = np.stack([state.base_pose[:, 0] for state in seen])
    assert np.diff(x, axis=0).min() >= 0.0
    age = np.stack([state.age for state in seen])[10:]
    assert age.min() >= 0.02
    assert 0.1 < age.max() <= 0.22 + 0.05
    behind = np.stack([(state.true_state.base_pose - state.base_pose)[:, 0] for state in seen])[10:]
    np.testing.assert_allclose(behind, age, atol=1e-9)


def test_all_that_is_measured_is_late(rig):
    late, inner = rig(SensorLatency, seconds=0.1), rig(EeNoise)
    late.adapter.backend = inner.adapter
    late.adapter.reset(inner.first.base_pose, late.joints)
    seen = [late.adapter.step(np.zeros((1, 6)), t, 0.1) for t in targets(5)]
    for now, before in zip(seen[1:], seen, strict=False):
        assert not np.array_equal(now.ee_in_base, before.ee_in_base)
    np.testing.assert_array_equal(seen[0].ee_in_base, inner.first.ee_in_base)
