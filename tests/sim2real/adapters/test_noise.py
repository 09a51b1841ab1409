from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE, Scan
from kinfeas.core.spatial import yaw
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.sim2real.adapters.noise import BaseNoise, EeNoise, JointNoise, Localisation, ScanNoise
from kinfeas.sim2real.adapters.random_numbers import normal, uniform

STILL = {"drift": 0.0, "turn_drift": 0.0, "jump": 0.0, "turn_jump": 0.0, "rate": 0.0}


def test_base_noise_is_added_to_the_planar_velocity(rig, drive):
    twists = drive(9)
    exact, plain, scaled = (
        rig(BaseNoise, linear=linear, angular=angular)
        for linear, angular in ((0.0, 0.0), (1.0, 1.0), (0.5, 0.1))
    )
    for one in (exact, plain, scaled):
        one.run(twists)
    np.testing.assert_array_equal(exact.passed, twists)
    noise = plain.passed - twists
    np.testing.assert_array_equal(noise[..., 2:5], 0.0)
    np.testing.assert_allclose((scaled.passed - twists)[..., :2], 0.5 * noise[..., :2])
    np.testing.assert_allclose((scaled.passed - twists)[..., 5], 0.1 * noise[..., 5])


def test_joint_noise_keeps_the_true_state(rig):
    noisy = rig(JointNoise, n=500, deviation=0.01)
    seen = noisy.run(np.zeros((4, 6)))
    found = np.stack([state.joint_positions for state in [noisy.first, *seen]])
    assert found.std() == pytest.approx(0.01, rel=0.05)
    assert len(np.unique(found)) == found.size
    for state in seen:
        np.testing.assert_array_equal(state.true_state.joint_positions, noisy.joints)
        assert state.base_pose is state.true_state.base_pose
    np.testing.assert_array_equal(noisy.sent, 0.0)


def test_ee_noise(rig, pr2):
    noisy = rig(EeNoise, n=2000, linear=0.01, angular=0.05)
    exact = forward(build_chain(pr2), noisy.joints)
    found = noisy.first.ee_in_base
    assert (found - exact)[:, :3].std(axis=0) == pytest.approx(np.full(3, 0.01), rel=0.07)
    turns = Rotation.from_quat(found[:, 3:]) * Rotation.from_quat(exact[:, 3:]).inv()
    assert turns.as_rotvec().std(axis=0) == pytest.approx(np.full(3, 0.05), rel=0.07)
    assert noisy.first.joint_positions is noisy.first.true_state.joint_positions
    assert noisy.first.true_state.ee_in_base is None


def errors(states):
    """Return how far the base is seen beside where it is, shape (steps, n, 3)."""
    return np.stack([
        np.column_stack([
            (state.base_pose - state.true_state.base_pose)[:, :2],
            yaw(state.base_pose) - yaw(state.true_state.base_pose),
        ])
        for state in states
    ])  # fmt: skip


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_drift_grows_with_the_root_of_time_at_any_rate(rig, dt):
    moving = rig(Localisation, n=1500, **(STILL | {"drift": 0.01, "turn_drift": 0.02}))
    np.testing.assert_array_equal(errors([moving.first]), 0.0)
    found = errors(moving.run(np.zeros((round(4.0 / dt), 6)), dt))
    expected = np.array([0.01, 0.01, 0.02])
    assert found[round(1.0 / dt) - 1].std(axis=0) == pytest.approx(expected, rel=0.08)
    assert found[-1].std(axis=0) == pytest.approx(2.0 * expected, rel=0.08)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_jumps_come_at_their_rate_and_lead_to_errors_of_their_size(rig, dt):
    jumpy = rig(Localisation, n=1000, **(STILL | {"rate": 0.5, "jump": 0.05, "turn_jump": 0.1}))
    found = errors(jumpy.run(np.zeros((round(6.0 / dt), 6)), dt))
    jumps = np.any(np.diff(found, axis=0) != 0.0, axis=2)
    assert jumps.mean() / dt == pytest.approx(0.5, rel=0.06)
    jump = found[-1][np.any(found[-1] != 0.0, axis=1)]
    assert jump.std(axis=0) == pytest.approx(np.array([0.05, 0.05, 0.1]), rel=0.08)


def test_commands_are_rotated_by_the_error(rig, drive):
    lost = rig(Localisation, n=4, **(STILL | {"turn_drift": 0.5}))
    twists = drive(30, n=4)
    angle = errors([lost.first, *lost.run(twists)])[:-1, :, 2]
    heading = np.arctan2(lost.passed[..., 1], lost.passed[..., 0])
    wanted = np.arctan2(twists[..., 1], twists[..., 0])
    turned = np.angle(np.exp(1j * (wanted - heading - angle)))
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)
    np.testing.assert_array_equal(lost.passed[..., 2:], twists[..., 2:])


@pytest.fixture
def scanned(rig):
    """Return a function that reads late scans of ranges that grow by 0.1 m in each step."""

    def made(n=1, **parameters):
        one = rig(ScanNoise, n=n, **parameters)
        ranges = [np.full((n, 2, SCAN_BEAMS), 1.0 + 0.1 * step) for step in range(12)]
        for grown in ranges:
            grown[:, 1, :5] = SCAN_RANGE
        one.adapter._exact = Mock(scan=lambda: Scan(ranges[len(one.recorder.twists)]))
        read = [one.adapter.scan().ranges]
        for twist in np.zeros((10, 6)):
            one.run([twist])
            read.append(one.adapter.scan().ranges)
            np.testing.assert_array_equal(one.adapter.scan().ranges, read[-1])
        return np.stack(read)

    return made


def test_scans_are_late_by_whole_periods(scanned):
    late = scanned(n=2, deviation=0.0, lost=0.0, seconds=0.31)[:, :, 0, 0]
    expected = 1.0 + 0.1 * np.maximum(np.arange(11) - 3, 0)
    np.testing.assert_allclose(late, np.stack([expected, expected], 1))


def test_noise_and_losses_of_scans_are_those_of_their_parameters(scanned):
    noisy = scanned(n=50, deviation=0.03, lost=0.0, seconds=0.0)
    expected = 1.0 + 0.1 * np.arange(11)[:, np.newaxis, np.newaxis]
    error = noisy[:, :, 0] - expected
    assert np.std(error) == pytest.approx(0.03, rel=0.03)
    assert np.mean(error) == pytest.approx(0.0, abs=0.001)
    np.testing.assert_array_equal(noisy[:, :, 1, :5], SCAN_RANGE)
    lossy = scanned(n=50, deviation=0.0, lost=0.1, seconds=0.0)
    assert np.mean(lossy[:, :, 0] == SCAN_RANGE) == pytest.approx(0.1, abs=0.01)
    np.testing.assert_array_equal(scanned(n=3, deviation=0.03), scanned(n=5, deviation=0.03)[:, :3])


def seeds(n, first=0):
    return np.arange(first, first + n, dtype=np.uint64)


def steps(n, value=0):
    return np.full(n, value, dtype=np.uint64)


@pytest.mark.parametrize(("draw", "law"), [(normal, "norm"), (uniform, "uniform")])
def test_draws_follow_their_law_in_each_column(draw, law):
    found = draw(seeds(20_000), steps(20_000), 12)
    for column in found.T:
        assert kstest(column, law).pvalue > 1e-3
    correlations = np.corrcoef(found.T) - np.eye(12)
    assert np.abs(correlations).max() < 5.0 / np.sqrt(20_000)


@pytest.mark.parametrize("draw", [normal, uniform])
def test_rows_and_steps_are_on_their_own(draw):
    together = draw(seeds(5), steps(5, 3), 4)
    for row in range(5):
        alone = draw(seeds(1, row), steps(1, 3), 4)
        np.testing.assert_array_equal(alone[0], together[row])
    assert np.intersect1d(together, draw(seeds(5), steps(5, 4), 4)).size == 0
