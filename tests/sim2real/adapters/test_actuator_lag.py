import numpy as np
import pytest

from kinfeas.sim2real.adapters.actuator_lag import ActuatorLag


@pytest.mark.parametrize("dt", [0.01, 0.1, 0.25])
@pytest.mark.parametrize("time", [0.05, 0.4])
def test_the_step_response_of_the_base_is_exponential_at_any_rate(rig, dt, time):
    lagging = rig(ActuatorLag, base=time, arm=0.0)
    steps = round(2.0 / dt)
    seen = lagging.run(np.tile([1.0, 0, 0, 0, 0, 0], (steps, 1)), dt)
    t = dt * np.arange(1, steps + 1)
    x = np.array([state.base_pose[0, 0] for state in seen])
    np.testing.assert_allclose(x, t - time * (1.0 - np.exp(-t / time)), atol=1e-12)


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_so_is_that_of_the_arm(rig, dt):
    lagging = rig(ActuatorLag, base=0.0, arm=0.2)
    steps = round(1.0 / dt)
    lagging.run(np.zeros((steps, 6)), dt, np.full((steps, 1, 7), 0.5))
    t = dt * np.arange(1, steps + 1)
    np.testing.assert_allclose(lagging.sent[:, 0, 0], 0.5 * (1.0 - np.exp(-t / 0.2)), atol=1e-12)


def test_after_one_time_constant_63_percent_are_done(rig):
    lagging = rig(ActuatorLag, base=0.0, arm=0.1)
    lagging.run(np.zeros((1, 6)), 0.1, np.ones((1, 1, 7)))
    assert lagging.sent[0, 0, 0] == pytest.approx(0.632, abs=1e-3)


def test_continuous_joints_take_the_short_way(rig):
    joints = np.zeros((1, 7))
    joints[0, 4] = 3.0
    lagging = rig(ActuatorLag, start=joints, base=0.0, arm=0.1)
    sent = np.tile(joints, (5, 1, 1))
    sent[..., 4] = -3.0
    lagging.run(np.zeros((5, 6)), 0.1, sent)
    assert np.all(np.abs(lagging.sent[..., 4]) > 3.0)
    assert np.all(np.abs(lagging.sent[..., 4]) <= np.pi)
