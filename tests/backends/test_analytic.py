import numpy as np

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.spatial import integrate
from tests.builders import random_bases


def twists(n):
    twist = np.zeros((n, 6))
    twist[:, [0, 1, 5]] = np.random.default_rng(1).normal(size=(n, 3))
    return twist


def test_commands_are_executed_exactly():
    backend, base = AnalyticBackend(), random_bases(4)
    joints = np.random.default_rng(2).normal(size=(4, 7))
    given = base.copy(), joints.copy()
    state = backend.reset(*given)
    for one in given:
        one[:] = 9.0  # arguments may be reused
    np.testing.assert_array_equal(state.base_pose, base)
    np.testing.assert_array_equal(state.joint_positions, joints)
    state = backend.step(twists(4), joints + 1.0, 0.1)
    np.testing.assert_array_equal(state.base_pose, integrate(base, twists(4), 0.1))
    np.testing.assert_array_equal(state.joint_positions, joints + 1.0)


def test_a_reset_of_rows_leaves_other_rows_and_old_states_alone():
    backend = AnalyticBackend()
    before = backend.reset(random_bases(4), np.zeros((4, 7)))
    held = before.base_pose.copy()
    after = backend.reset(random_bases(2, seed=3), np.ones((2, 7)), np.array([3, 0]))
    np.testing.assert_array_equal(after.base_pose[[3, 0]], random_bases(2, seed=3))
    np.testing.assert_array_equal(after.base_pose[[1, 2]], held[[1, 2]])
    np.testing.assert_array_equal(after.joint_positions.sum(axis=1), [7, 0, 0, 7])
    np.testing.assert_array_equal(before.base_pose, held)
    assert not before.joint_positions.any()
