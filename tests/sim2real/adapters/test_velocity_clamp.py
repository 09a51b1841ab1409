import numpy as np
import pytest

from kinfeas.sim2real.adapters.velocity_clamp import VelocityClamp


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_limits_are_never_exceeded(rig, drive, pr2, dt):
    clamped = rig(VelocityClamp, n=9, linear=0.1, angular=0.3, joints=0.5)
    sent = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 9, 7))
    clamped.run(drive(50, n=9) * 2.0, dt, sent)
    assert np.linalg.norm(clamped.passed[..., :3], axis=-1).max() == pytest.approx(0.1)
    assert np.abs(clamped.passed[..., 5]).max() == pytest.approx(0.3)
    moves = np.diff(np.concatenate([clamped.joints[np.newaxis], clamped.sent]), axis=0)
    moves = np.where(clamped.adapter.continuous, np.angle(np.exp(1j * moves)), moves)
    assert np.all(np.abs(moves) <= 0.5 * pr2.max_joint_velocity * dt * (1.0 + 1e-9))


def test_what_is_slow_enough_passes_to_the_bit(rig, drive):
    clamped = rig(VelocityClamp, linear=9.0, angular=9.0)
    sent = np.cumsum(np.random.default_rng(0).uniform(-0.05, 0.05, (50, 1, 7)), axis=0)
    twists = drive(50)
    clamped.run(twists, 0.1, sent)
    np.testing.assert_array_equal(clamped.passed, twists)
    np.testing.assert_array_equal(clamped.sent, sent)


def test_a_joint_goes_on_toward_a_far_target(rig, pr2):
    clamped = rig(VelocityClamp)
    clamped.run(np.zeros((20, 6)), 0.1, np.full((20, 1, 7), 1.0))
    way = np.arange(1, 21) * pr2.arm[0].velocity * 0.1
    np.testing.assert_allclose(clamped.sent[:, 0, 0], np.minimum(way, 1.0))


def test_the_robots_own_limits_are_the_default(rig, pr2):
    ranges = rig(VelocityClamp).adapter.ranges
    assert ranges["linear"].low == pr2.base.max_velocity
    assert ranges["angular"].low == pr2.base.max_rotation
