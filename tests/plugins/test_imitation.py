"""The imitation motion comes to its path from anywhere, follows it and ends where it was shown."""

import inspect
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Demonstrated
from kinfeas.core.spatial import compose, make_pose, relative
from kinfeas.plugins.imitation import Imitation, learned_path, read_model, shipped_models
from kinfeas.testing import check_motion_generator
from tests.plugins.conftest import DT, apart, random_poses, run, speeds

GROUP = "kinfeas.motion_generators"


@pytest.fixture(scope="module")
def generator(models):
    return Imitation(model=models["imitation"])


def starts_and_targets(n, seed):
    """Return starts up to 3 m away from the targets, and the targets, turned any way."""
    targets, away = random_poses(n, seed), random_poses(n, seed + 1, reach=3.0)
    away[:, :3] += targets[:, :3]
    return away, targets


@pytest.mark.parametrize(
    "parameters", [{}, {"max_velocity": 0.05, "max_angular_velocity": 0.3}, {"gain": 20.0}]
)
def test_keeps_the_contract(parameters, models):
    limit = parameters.get("max_angular_velocity", 0.1)
    generator = Imitation(model=models["imitation"], **parameters)
    check_motion_generator(generator, max_angular_velocity=limit)
    assert isinstance(generator, Demonstrated)


def test_hundreds_of_motions_from_up_to_3_m_away_arrive_within_their_limits(generator):
    start, target = starts_and_targets(400, 0)
    poses, twists, state = run(generator, start, target, 60.0)
    metres, radians = apart(poses[-1], generator.goal_pose(state, target))
    assert metres.max() < 0.01
    assert np.rad2deg(radians.max()) < 3.0
    linear, angular = speeds(twists)
    assert linear.max() <= 0.1 * (1.0 + 1e-9)
    assert angular.max() <= 0.1 * (1.0 + 1e-9)


@given(st.integers(0, 2**32 - 2), st.sampled_from([0.02, 0.1, 0.5]))
@settings(max_examples=10)
def test_arrives_from_anywhere_at_any_rate(generator, seed, dt):
    start, target = starts_and_targets(8, seed)
    poses, twists, state = run(generator, start, target, 80.0, dt)
    metres, radians = apart(poses[-1], generator.goal_pose(state, target))
    assert max(metres.max(), radians.max()) < 1e-6
    linear, angular = speeds(twists)
    assert max(linear.max(), angular.max()) <= 0.1 * (1.0 + 1e-9)


def test_ends_at_the_learned_end_in_the_frame_of_the_object(generator, models):
    start, target = starts_and_targets(20, 5)
    goal = generator.goal_pose(generator.start(start, target, []), target)
    learned = np.array(read_model(models["imitation"], "imitation").goal)
    metres, radians = apart(relative(goal, target), learned)
    assert max(metres.max(), radians.max()) < 1e-7


def test_turns_with_the_object(generator):
    start, target = starts_and_targets(6, 7)
    moved = np.repeat(make_pose(np.array([[1.0, -2.0, 0.3]]), Rotation.random(1, rng=3)), 6, axis=0)
    here, _, _ = run(generator, start, target, 40.0)
    there, _, _ = run(generator, compose(moved, start), compose(moved, target), 40.0)
    metres, radians = apart(there, compose(moved, here))
    assert metres.max() < 1e-9
    assert radians.max() < 1e-7


def test_comes_to_the_beginning_before_it_goes_on(generator, models):
    path = learned_path(read_model(models["imitation"], "imitation"))
    start, target = starts_and_targets(20, 9)
    poses, _, _ = run(generator, start, target, 60.0)
    begin = compose(target, np.repeat(path.knots[:1], 20, axis=0))
    metres, radians = apart(poses, begin)
    # The phase begins to move within a fraction of its scales, 5 cm and 0.3 rad.
    assert np.all((metres < 0.08).any(axis=0))
    assert np.all((radians < 0.4).any(axis=0))


def test_follows_the_path_that_was_shown(generator, models):
    path = learned_path(read_model(models["imitation"], "imitation"))
    start = path.knots[:1]
    poses, _, _ = run(generator, start, np.eye(1, 7, 6), 30.0)
    metres = np.linalg.norm(poses[:, 0, np.newaxis, :3] - path.knots[:, :3], axis=-1)
    assert metres.min(axis=1).max() < 4e-3
    assert metres.min(axis=0).max() < 1e-2


def test_phase_waits_for_a_hand_that_is_held(generator):
    start, target = starts_and_targets(4, 11)
    state = generator.start(start, target, [])
    for _ in range(200):
        _, state = generator.twist(state, start, target, np.full(len(start), DT))
    assert state["phase"].max() < 1e-3


def test_a_hand_that_is_pushed_comes_back(generator):
    start, target = starts_and_targets(4, 13)
    poses, _, state = run(generator, start, target, 45.0)
    ee = poses[-1] + np.array([0.3, -0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    ee, goal = ee[np.newaxis], generator.goal_pose(state, target)
    twist, _ = generator.twist(state, ee[0], target, np.full(len(ee[0]), DT))
    assert np.all(np.sum(twist[:, :3] * (goal - ee[0])[:, :3], axis=1) > 0.0)


def test_is_at_rest_at_the_end(generator):
    start, target = starts_and_targets(5, 15)
    _, twists, state = run(generator, start, target, 100.0)
    assert np.abs(twists[-1]).max() < 1e-9
    assert np.array_equal(state["phase"], np.ones(5))


def test_the_base_goes_along(generator):
    start, target = starts_and_targets(5, 17)
    _, _, state = run(generator, start, target, 100.0)
    first = generator.base_pose(generator.start(start, target, []), target)
    last = generator.base_pose(state, target)
    assert first.shape == last.shape == (5, 7)
    assert np.allclose(apart(first, last)[0], np.hypot(0.3, 0.3), atol=0.03)
    assert np.all(last[:, 2] == 0.0)


def test_the_base_is_not_known_if_not_shown(models):
    generator = Imitation(model=models["nobase"])
    start, target = starts_and_targets(2, 0)
    assert np.isnan(generator.base_pose(generator.start(start, target, []), target)).all()


def test_a_row_has_the_same_bits_in_any_batch(generator):
    start, target = starts_and_targets(37, 0)
    poses, twists, state = run(generator, start, target, 50.0)
    base = generator.base_pose(state, target)
    for rows in (slice(0, 1), slice(36, 37), slice(3, 20), slice(0, 37, 3)):
        some_poses, some_twists, some = run(generator, start[rows], target[rows], 50.0)
        assert np.array_equal(some_poses, poses[:, rows])
        assert np.array_equal(some_twists, twists[:, rows])
        assert np.array_equal(generator.base_pose(some, target[rows]), base[rows])


def test_no_motions_are_motions_too(generator):
    none = np.zeros((0, 7))
    twist, state = generator.twist(
        generator.start(none, none, []), none, none, np.full(len(none), DT)
    )
    assert twist.shape == (0, 6)
    assert generator.goal_pose(state, none).shape == (0, 7)
    assert generator.base_pose(state, none).shape == (0, 7)


@pytest.mark.parametrize(
    "name", ["gain", "position_scale", "rotation_scale", "max_velocity", "max_angular_velocity"]
)
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, "fast"])
def test_refuses_numbers_that_are_not_positive(name, value, models):
    with pytest.raises(KinfeasError, match=f"^{name} must be a positive number, not "):
        Imitation(model=models["imitation"], **{name: value})


def test_says_which_models_there_are():
    known = ", ".join(shipped_models()) or "none"
    with pytest.raises(KinfeasError, match=f"path of a file or a shipped one: {known}"):
        registry.build(GROUP, "imitation", {})
    with pytest.raises(KinfeasError, match=f"unknown model 'dor'.*known are {known}"):
        registry.build(GROUP, "imitation", {"model": "dor"})


def test_takes_keywords_only():
    kinds = {p.kind for p in inspect.signature(Imitation).parameters.values()}
    assert kinds == {inspect.Parameter.KEYWORD_ONLY}


def test_a_step_of_128_motions_is_quick(generator):
    start, target = starts_and_targets(128, 0)
    state = generator.start(start, target, [])
    seconds = []
    for _ in range(20):
        began = time.perf_counter()
        generator.twist(state, start, target, np.full(len(start), DT))
        seconds.append(time.perf_counter() - began)
    assert min(seconds) / 128 < 10e-6  # measured: 1.4 us
