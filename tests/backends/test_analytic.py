import numpy as np

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.core.backend import Resumable, Stochastic
from kinfeas.core.spatial import integrate, planar_pose


def bases(n, seed=0):
    rng = np.random.default_rng(seed)
    return planar_pose(*rng.uniform(-1.0, 1.0, (2, n)), rng.uniform(-np.pi, np.pi, n))


def twists(n, seed=1):
    twist = np.zeros((n, 6))
    twist[:, [0, 1, 5]] = np.random.default_rng(seed).normal(size=(n, 3))
    return twist


def test_commands_are_carried_out_exactly_and_at_once():
    backend = AnalyticBackend()
    base, joints = bases(4), np.random.default_rng(2).normal(size=(4, 7))
    state = backend.reset(base, joints)
    np.testing.assert_array_equal(state.base_pose, base)
    np.testing.assert_array_equal(state.joint_positions, joints)
    state = backend.step(twists(4), joints + 1.0, 0.1)
    np.testing.assert_array_equal(state.base_pose, integrate(base, twists(4), 0.1))
    np.testing.assert_array_equal(state.joint_positions, joints + 1.0)


def test_reset_of_rows_leaves_the_others_and_the_past_alone():
    backend = AnalyticBackend()
    before = backend.reset(bases(4), np.zeros((4, 7)))
    held = before.base_pose.copy(), before.joint_positions.copy()
    fresh = bases(2, seed=3)
    after = backend.reset(fresh, np.ones((2, 7)), np.array([3, 0]))
    np.testing.assert_array_equal(after.base_pose[[3, 0]], fresh)
    np.testing.assert_array_equal(after.base_pose[[1, 2]], held[0][[1, 2]])
    np.testing.assert_array_equal(after.joint_positions.sum(axis=1), [7, 0, 0, 7])
    np.testing.assert_array_equal(before.base_pose, held[0])
    np.testing.assert_array_equal(before.joint_positions, held[1])


def test_arguments_may_be_reused():
    backend = AnalyticBackend()
    base, joints = bases(2), np.zeros((2, 7))
    backend.reset(base, joints)
    base[:], joints[:] = 9.0, 9.0
    targets = np.ones((2, 7))
    np.testing.assert_array_equal(backend.state.joint_positions, 0.0)
    state = backend.step(np.zeros((2, 6)), targets, 0.1)
    targets[:] = 9.0
    np.testing.assert_array_equal(state.joint_positions, 1.0)
    assert np.abs(state.base_pose[:, :2]).max() <= 1.0


def test_goes_on_from_a_snapshot():
    backend, other = AnalyticBackend(), AnalyticBackend()
    backend.reset(bases(3), np.zeros((3, 7)))
    saved = backend.snapshot()
    backend.step(twists(3), np.ones((3, 7)), 0.1)
    restored = other.restore(saved)
    np.testing.assert_array_equal(restored.base_pose, bases(3))
    np.testing.assert_array_equal(
        other.step(twists(3), np.ones((3, 7)), 0.1).base_pose, backend.state.base_pose
    )


def test_draws_nothing_and_closes_twice():
    backend = AnalyticBackend()
    assert not isinstance(backend, Stochastic)
    assert isinstance(backend, Resumable)
    backend.close()
    backend.close()
