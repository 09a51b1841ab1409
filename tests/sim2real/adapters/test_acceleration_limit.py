import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.adapters.acceleration_limit import AccelerationLimit

PARTS = ((slice(0, 3), "linear"), (slice(3, 6), "angular"))
LIMITS = {"linear": 0.7, "angular": 1.5}
JERKS = {"linear_jerk": 4.0, "angular_jerk": 6.0}


def rates(values, dt):
    """Return how fast values change, from rest, shape (steps, n, 6)."""
    return np.diff(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0) / dt


@pytest.mark.parametrize("dt", [0.02, 0.1])
@pytest.mark.parametrize("jerks", [{}, JERKS])
def test_limits_are_never_exceeded(rig, drive, dt, jerks):
    limited = rig(AccelerationLimit, n=20, **LIMITS, **jerks)
    limited.run(drive(300, n=20) * 3.0, dt)
    acceleration = rates(limited.passed, dt)
    jerk = rates(acceleration, dt)
    for part, name in PARTS:
        found = np.linalg.norm(acceleration[..., part], axis=-1)
        assert found.max() <= LIMITS[name] * (1.0 + 1e-9)
        assert found.max() > 0.9 * LIMITS[name]
        if jerks:
            assert np.linalg.norm(jerk[..., part], axis=-1).max() <= JERKS[f"{name}_jerk"] * 1.001


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_a_ramp_takes_the_time_that_it_must(rig, dt):
    limited = rig(AccelerationLimit, linear=0.5, angular=1.0)
    limited.run(np.tile([1.0, 0, 0, 0, 0, -1.0], (round(3.0 / dt), 1)), dt)
    t = dt * np.arange(1, round(3.0 / dt) + 1)
    np.testing.assert_allclose(limited.passed[:, 0, 0], np.minimum(0.5 * t, 1.0), atol=1e-12)
    np.testing.assert_allclose(limited.passed[:, 0, 5], -np.minimum(t, 1.0), atol=1e-12)


def test_with_limited_jerk_the_command_is_met_and_hardly_passed(rig):
    limited = rig(AccelerationLimit, linear=0.5, angular=1.0, **JERKS)
    limited.run(np.tile([0.2, 0.1, 0, 0, 0, 0.8], (150, 1)), 0.02)
    assert limited.passed[-1, 0] == pytest.approx(np.array([0.2, 0.1, 0, 0, 0, 0.8]), abs=1e-3)
    assert limited.passed[..., 0].max() < 0.2 * 1.05
    assert limited.passed[..., 5].max() < 0.8 * 1.05


def test_the_robots_own_limits_are_the_default(rig, pr2):
    ranges = rig(AccelerationLimit).adapter.ranges
    assert ranges["linear"].low == pr2.base.max_acceleration
    assert ranges["angular"].low == pr2.base.max_rotation_acceleration


@pytest.mark.parametrize("name", ["linear", "angular_jerk"])
def test_a_limit_is_above_nothing(pr2, name):
    with pytest.raises(KinfeasError, match=f"{name} is 0, must be a finite number > 0"):
        wrap(object(), [PluginSpec("acceleration_limit", {name: 0})], pr2)
