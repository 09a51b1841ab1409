import numpy as np
import pytest

from kinfeas.sim2real.adapters.joint_noise import JointNoise


def test_what_is_measured_scatters_and_what_is_is_beside_it(rig):
    noisy = rig(JointNoise, n=500, deviation=0.01)
    seen = noisy.run(np.zeros((4, 6)))
    found = np.stack([state.joint_positions for state in [noisy.first, *seen]])
    assert found.std() == pytest.approx(0.01, rel=0.05)
    assert len(np.unique(found)) == found.size
    for state in seen:
        np.testing.assert_array_equal(state.true_state.joint_positions, noisy.joints)
        assert state.base_pose is state.true_state.base_pose
    np.testing.assert_array_equal(noisy.sent, 0.0)


def test_continuous_joints_stay_in_their_turn(rig):
    joints = np.zeros((300, 7))
    joints[:, [4, 6]] = np.pi
    found = rig(JointNoise, n=300, start=joints, deviation=0.1).first.joint_positions[:, [4, 6]]
    assert np.abs(found).max() <= np.pi
    assert (found < 0.0).any()
