import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import make_pose
from kinfeas.sim2real.vectors import displaced, length, shortened


def test_vectors_are_shortened_and_never_turned():
    vector = np.random.default_rng(0).normal(size=(50, 3))
    found = shortened(vector, np.full((50, 1), 0.5))
    assert length(found).max() <= 0.5 + 1e-15
    np.testing.assert_allclose(np.cross(found, vector), 0.0, atol=1e-15)
    np.testing.assert_array_equal(shortened(vector, np.full((50, 1), 9.0)), vector)
    np.testing.assert_array_equal(shortened(np.zeros((1, 3)), np.zeros((1, 1))), 0.0)


def test_a_displacement_of_nothing_leaves_every_bit():
    rng = np.random.default_rng(0)
    pose = make_pose(rng.normal(size=(20, 3)), Rotation.random(20, random_state=0))
    np.testing.assert_array_equal(displaced(pose, np.zeros((20, 6))), pose)
    by = np.array([[0.1, 0.2, 0.3, 0.0, 0.0, 0.5]])
    moved = displaced(pose[:1], by)
    np.testing.assert_allclose(moved[0, :3], pose[0, :3] + by[0, :3])
    turn = Rotation.from_quat(moved[0, 3:]) * Rotation.from_quat(pose[0, 3:]).inv()
    np.testing.assert_allclose(turn.as_rotvec(), by[0, 3:], atol=1e-12)
