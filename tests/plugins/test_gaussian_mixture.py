"""The reference runs through time, and the hand arrives all the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Demonstrated
from kinfeas.core.spatial import compose, distance, relative
from kinfeas.plugins.imitation import GaussianMixture, learned_path, read_model
from kinfeas.testing import check_motion_generator
from tests.plugins.conftest import DT, apart, random_poses, run, speeds
from tests.plugins.properties import check_arrival


@pytest.fixture(scope="module")
def generator(models):
    return GaussianMixture(model=models["gaussian_mixture"])


@pytest.fixture(scope="module")
def path(models):
    return learned_path(read_model(models["gaussian_mixture"], "gaussian_mixture"))


def starts_and_targets(n, seed):
    targets, away = random_poses(n, seed), random_poses(n, seed + 1, reach=3.0)
    away[:, :3] += targets[:, :3]
    return away, targets


def test_keeps_the_contract(models):
    model = {"model": models["gaussian_mixture"]}
    generator = registry.build("kinfeas.motion_generators", "gaussian_mixture", model)
    assert isinstance(generator, Demonstrated)
    check_motion_generator(generator)


@given(st.integers(0, 2**32 - 2), st.sampled_from([0.02, 0.1, 0.5]))
@settings(max_examples=10)
def test_arrives_from_anywhere_within_its_limits(generator, seed, dt):
    start, target = starts_and_targets(20, seed)
    poses, twists, state = run(generator, start, target, 70.0, dt)
    metres, radians = apart(poses[-1], generator.goal_pose(state, target))
    assert max(metres.max(), radians.max()) < 1e-9
    linear, angular = speeds(twists)
    assert max(linear.max(), angular.max()) <= 0.1 * (1.0 + 1e-9)


def test_hundreds_of_motions_from_up_to_3_m_away_arrive_within_their_limits(generator):
    check_arrival(generator, 100.0, n=400)


def test_keeps_to_the_clock_where_it_can(generator, path):
    target = random_poses(3, 0)
    start = compose(target, np.repeat(path.knots[:1], 3, axis=0))
    poses, _, state = run(generator, start, target, 30.0)
    for share in (0.25, 0.5, 1.0):
        now = relative(poses[round(300 * share)], target)
        metres, radians = distance(now, path.at(np.full(3, share)))
        assert metres.max() < 1e-3
        assert radians.max() < 0.02
    assert np.allclose(state["phase"], 1.0)


def test_reference_runs_ahead_of_a_start_that_is_far(generator, path):
    start, target = random_poses(4, 1), random_poses(4, 2)
    start[:, :3] = target[:, :3] + np.array([2.5, 0.0, 0.0])
    poses, _, state = run(generator, start, target, 10.0)
    reference = compose(target, path.at(state["phase"]))
    assert distance(reference, poses[-1])[0].min() > 0.5


def test_the_base_goes_along(generator):
    start, target = starts_and_targets(3, 3)
    _, _, state = run(generator, start, target, 31.0)
    first = generator.base_pose(generator.start(start, target, []), target)
    assert np.allclose(
        apart(first, generator.base_pose(state, target))[0], np.hypot(0.3, 0.3), atol=0.03
    )


def test_a_row_has_the_same_bits_in_any_batch(generator):
    start, target = starts_and_targets(37, 0)
    poses, _, _ = run(generator, start, target, 40.0)
    for rows in (slice(0, 1), slice(3, 20), slice(0, 37, 3)):
        assert np.array_equal(run(generator, start[rows], target[rows], 40.0)[0], poses[:, rows])


def test_no_motions_are_motions_too(generator):
    none = np.zeros((0, 7))
    twist, _ = generator.twist(generator.start(none, none, []), none, none, np.full(len(none), DT))
    assert twist.shape == (0, 6)


@pytest.mark.parametrize("name", ["max_velocity", "max_angular_velocity"])
def test_refuses_numbers_that_are_not_positive(name, models):
    with pytest.raises(KinfeasError, match=f"^{name} must be a positive number, not 0"):
        GaussianMixture(model=models["gaussian_mixture"], **{name: 0.0})


def test_refuses_a_model_of_the_other_kind(models):
    with pytest.raises(KinfeasError, match="'kind' must be 'gaussian_mixture' here"):
        GaussianMixture(model=models["imitation"])
