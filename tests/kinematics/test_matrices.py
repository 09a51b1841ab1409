import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.kinematics.kernels import write_matrix, write_pose


def test_a_pose_becomes_a_matrix_and_a_pose_again():
    rng = np.random.default_rng(0)
    matrix, pose = np.empty((3, 3)), np.empty(7)
    for _ in range(200):
        position, quaternion = rng.normal(size=3), Rotation.random(rng=rng).as_quat(canonical=True)
        write_matrix(np.concatenate([position, quaternion]), matrix)
        np.testing.assert_allclose(matrix, Rotation.from_quat(quaternion).as_matrix(), atol=1e-14)
        write_pose(position, matrix, pose)
        np.testing.assert_allclose(pose, [*position, *quaternion], atol=1e-14)


def test_half_turns_have_a_unit_quaternion():
    matrix, pose = np.empty((3, 3)), np.empty(7)
    for axis in np.eye(3):
        write_matrix(np.array([0.0, 0.0, 0.0, *axis, 0.0]), matrix)
        write_pose(np.zeros(3), matrix, pose)
        np.testing.assert_allclose(np.abs(pose[3:]), [*axis, 0.0], atol=1e-15)
