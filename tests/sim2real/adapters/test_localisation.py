import numpy as np
import pytest

from kinfeas.core.spatial import yaw
from kinfeas.sim2real.adapters.localisation import Localisation

STILL = {"drift": 0.0, "turn_drift": 0.0, "jump": 0.0, "turn_jump": 0.0, "rate": 0.0}


def errors(states):
    """Return how far the base is seen beside where it is, shape (steps, n, 3)."""
    return np.stack([
        np.column_stack([
            (state.base_pose - state.true_state.base_pose)[:, :2],
            yaw(state.base_pose) - yaw(state.true_state.base_pose),
        ])
        for state in states
    ])  # fmt: skip


def test_an_episode_begins_without_an_error(rig):
    found = rig(Localisation, n=5)
    np.testing.assert_array_equal(errors([found.first]), 0.0)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_drift_grows_with_the_root_of_time_at_any_rate(rig, dt):
    moving = rig(Localisation, n=1500, **(STILL | {"drift": 0.01, "turn_drift": 0.02}))
    found = errors(moving.run(np.zeros((round(4.0 / dt), 6)), dt))
    expected = np.array([0.01, 0.01, 0.02])
    assert found[round(1.0 / dt) - 1].std(axis=0) == pytest.approx(expected, rel=0.08)
    assert found[-1].std(axis=0) == pytest.approx(2.0 * expected, rel=0.08)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_jumps_come_at_their_rate_and_lead_to_errors_of_their_size(rig, dt):
    jumpy = rig(Localisation, n=1000, **(STILL | {"rate": 0.5, "jump": 0.05, "turn_jump": 0.1}))
    found = errors(jumpy.run(np.zeros((round(6.0 / dt), 6)), dt))
    joint_jumps = np.any(np.diff(found, axis=0) != 0.0, axis=2)
    assert joint_jumps.mean() / dt == pytest.approx(0.5, rel=0.06)
    joint_jump = found[-1][np.any(found[-1] != 0.0, axis=1)]
    assert joint_jump.std(axis=0) == pytest.approx(np.array([0.05, 0.05, 0.1]), rel=0.08)


def test_commands_are_carried_out_in_axes_that_are_turned_by_the_error(rig, drive):
    lost = rig(Localisation, n=4, **(STILL | {"turn_drift": 0.5}))
    twists = drive(30, n=4)
    angle = errors([lost.first, *lost.run(twists)])[:-1, :, 2]
    heading = np.arctan2(lost.passed[..., 1], lost.passed[..., 0])
    wanted = np.arctan2(twists[..., 1], twists[..., 0])
    turned = np.angle(np.exp(1j * (wanted - heading - angle)))
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)
    np.testing.assert_array_equal(lost.passed[..., 2:], twists[..., 2:])
