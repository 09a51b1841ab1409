from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from kinfeas.core.backend import LOCALISATION_SPEED, SCAN_BEAMS, SCAN_RANGE, Scan
from kinfeas.core.spatial import distance, yaw
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.sim2real.adapters.adapter import normal, uniform
from kinfeas.sim2real.adapters.noise import BaseNoise, EeNoise, JointNoise, Localisation, ScanNoise

STILL = {"drift": 0.0, "turn_drift": 0.0, "jump": 0.0, "turn_jump": 0.0, "rate": 0.0}


def test_base_noise_is_added_to_the_planar_velocity(rig, drive):
    twists = drive(9)
    plain, scaled = rig(BaseNoise, linear=1.0, angular=1.0), rig(BaseNoise, linear=0.5, angular=0.1)
    for noisy in (plain, scaled):
        noisy.run(twists)
    noise = plain.passed - twists
    np.testing.assert_array_equal(noise[..., 2:5], 0.0)
    np.testing.assert_allclose((scaled.passed - twists)[..., :2], 0.5 * noise[..., :2])
    np.testing.assert_allclose((scaled.passed - twists)[..., 5], 0.1 * noise[..., 5])


def test_joint_noise_keeps_the_true_state(rig):
    noisy = rig(JointNoise, n=500, deviation=0.01)
    states = noisy.run(np.zeros((4, 6)))
    values = np.stack([state.joint_positions for state in [noisy.first, *states]])
    assert values.std() == pytest.approx(0.01, rel=0.05)
    assert len(np.unique(values)) == values.size
    for state in states:
        np.testing.assert_array_equal(state.true_state.joint_positions, noisy.joints)
        assert state.base_pose is state.true_state.base_pose
    np.testing.assert_array_equal(noisy.sent, 0.0)


def test_ee_noise(rig, pr2):
    noisy = rig(EeNoise, n=2000, linear=0.01, angular=0.05)
    exact = forward(build_chain(pr2), noisy.joints)
    values = noisy.first.ee_in_base
    assert (values - exact)[:, :3].std(axis=0) == pytest.approx(np.full(3, 0.01), rel=0.07)
    turns = Rotation.from_quat(values[:, 3:]) * Rotation.from_quat(exact[:, 3:]).inv()
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
def test_drift_grows_with_the_root_of_time_and_rotates_commands(rig, drive, dt):
    moving = rig(Localisation, n=1500, **(STILL | {"drift": 0.01, "turn_drift": 0.02}))
    np.testing.assert_array_equal(errors([moving.first]), 0.0)
    twists = drive(round(4.0 / dt), n=1500)
    values = errors(moving.run(twists, dt))
    direction, passed = (
        np.arctan2(sent[1:, :, 1], sent[1:, :, 0]) for sent in (twists, moving.passed)
    )
    rotated = np.angle(np.exp(1j * (direction - passed - values[:-1, :, 2])))
    np.testing.assert_allclose(rotated, 0.0, atol=1e-9)
    np.testing.assert_array_equal(moving.passed[..., 2:], twists[..., 2:])
    expected = np.array([0.01, 0.01, 0.02])
    assert values[round(1.0 / dt) - 1].std(axis=0) == pytest.approx(expected, rel=0.08)
    assert values[-1].std(axis=0) == pytest.approx(2.0 * expected, rel=0.08)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_jumps_come_at_their_rate_and_lead_to_errors_of_their_size(rig, dt):
    jumpy = rig(Localisation, n=1000, **(STILL | {"rate": 0.5, "jump": 0.05, "turn_jump": 0.1}))
    values = errors(jumpy.run(np.zeros((round(6.0 / dt), 6)), dt))
    jumps = np.any(np.diff(values, axis=0) != 0.0, axis=2)
    assert jumps.mean() / dt == pytest.approx(0.5, rel=0.06)
    jump = values[-1][np.any(values[-1] != 0.0, axis=1)]
    assert jump.std(axis=0) == pytest.approx(np.array([0.05, 0.05, 0.1]), rel=0.08)


@pytest.mark.parametrize("dt", [0.02, 0.1])
def test_robots_that_follow_their_localisation_are_late_by_its_jumps(rig, dt):
    jumpy = rig(Localisation, n=20, **(STILL | {"rate": 0.3, "jump": 0.05, "turn_jump": 0.1}))
    states = jumpy.run(np.zeros((round(6.0 / dt), 6)), dt)
    exact = jumpy.first.localised
    np.testing.assert_array_equal(exact, jumpy.first.true_state.base_pose)
    reached = 0
    for state in states:
        moved, turned = distance(state.localised, exact)
        assert max(moved.max(), turned.max()) <= LOCALISATION_SPEED * dt + 1e-9
        exact, left = state.localised, distance(state.localised, state.base_pose)
        reached += np.sum((left[0] < 1e-9) & (left[1] < 1e-9))
    assert 0.5 < reached / 20 / len(states) < 0.95


@pytest.fixture
def scanned(rig):
    """Return a function that reads late scans of ranges that grow by 0.1 m in each step."""

    def made(n=1, **parameters):
        noisy = rig(ScanNoise, n=n, **parameters)
        ranges = [np.full((n, 2, SCAN_BEAMS), 1.0 + 0.1 * step) for step in range(12)]
        for grown in ranges:
            grown[:, 1, :5] = SCAN_RANGE
        noisy.adapter._exact = Mock(scan=lambda: Scan(ranges[noisy.steps.call_count]))
        read = [noisy.adapter.scan().ranges]
        for twist in np.zeros((10, 6)):
            noisy.run([twist])
            scan = noisy.adapter.scan()
            assert scan.age == pytest.approx(0.1 * round(parameters.get("seconds", 0.1) / 0.1))
            read.append(scan.ranges)
            np.testing.assert_array_equal(noisy.adapter.scan().ranges, read[-1])
        return np.stack(read)

    return made


def test_delay_noise_and_losses_of_scans_are_those_of_their_parameters(scanned):
    late = scanned(n=2, deviation=0.0, lost=0.0, seconds=0.31)[:, :, 0, 0]
    np.testing.assert_allclose(late.T, [1.0 + 0.1 * np.maximum(np.arange(11) - 3, 0)] * 2)
    noisy = scanned(n=50, deviation=0.03, lost=0.0, seconds=0.0)
    error = noisy[:, :, 0] - 1.0 - 0.1 * np.arange(11)[:, np.newaxis, np.newaxis]
    assert np.std(error) == pytest.approx(0.03, rel=0.03)
    assert np.mean(error) == pytest.approx(0.0, abs=0.001)
    np.testing.assert_array_equal(noisy[:, :, 1, :5], SCAN_RANGE)
    lossy = scanned(n=50, deviation=0.0, lost=0.1, seconds=0.0)
    assert np.mean(lossy[:, :, 0] == SCAN_RANGE) == pytest.approx(0.1, abs=0.01)
    np.testing.assert_array_equal(scanned(n=3, deviation=0.03), scanned(n=5, deviation=0.03)[:, :3])


@pytest.mark.parametrize(("draw", "law"), [(normal, "norm"), (uniform, "uniform")])
def test_draws_follow_their_law_in_each_column(draw, law):
    seeds = np.arange(20_000, dtype=np.uint64)
    values = draw(seeds, np.zeros_like(seeds), 12)
    for column in values.T:
        assert kstest(column, law).pvalue > 1e-3
    correlations = np.corrcoef(values.T) - np.eye(12)
    assert np.abs(correlations).max() < 5.0 / np.sqrt(20_000)
