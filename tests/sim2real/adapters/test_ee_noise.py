import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.sim2real.adapters.ee_noise import EeNoise
from kinfeas.sim2real.adapters.joint_noise import JointNoise


def test_the_ee_scatters_about_where_the_joints_have_it(rig, pr2):
    noisy = rig(EeNoise, n=2000, linear=0.01, angular=0.05)
    exact = forward(build_chain(pr2), noisy.joints)
    found = noisy.first.ee_in_base
    assert (found - exact)[:, :3].std(axis=0) == pytest.approx(np.full(3, 0.01), rel=0.07)
    turns = Rotation.from_quat(found[:, 3:]) * Rotation.from_quat(exact[:, 3:]).inv()
    assert turns.as_rotvec().std(axis=0) == pytest.approx(np.full(3, 0.05), rel=0.07)
    assert noisy.first.joint_positions is noisy.first.true_state.joint_positions
    assert noisy.first.true_state.ee_in_base is None


def test_around_another_measured_ee_it_adds_to_that(rig, pr2):
    within = rig(EeNoise, n=2000, linear=0.01, angular=0.0)
    around = JointNoise(EeNoise(within.adapter, pr2, linear=0.01, angular=0.0), pr2)
    around.seed(np.arange(2000, dtype=np.uint64), np.arange(2000))
    found = around.reset(within.first.base_pose, within.joints).ee_in_base
    exact = forward(build_chain(pr2), within.joints)
    assert (found - exact)[:, 0].std() == pytest.approx(0.01 * np.sqrt(2.0), rel=0.07)
