"""The linear motion arrives, keeps its limits, and keeps position and orientation in step."""

import inspect
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance, integrate, make_pose, rotation, twist_between
from kinfeas.plugins.linear import Linear
from kinfeas.testing import check_motion_generator

DT = 0.1
ORIGIN = np.array([0.3, -1.0, 0.7])

seeds = st.integers(0, 2**32 - 1)


def random_poses(n, seed):
    rng = np.random.default_rng(seed)
    quaternion = Rotation.from_quat(rng.normal(size=(n, 4)) if n else np.zeros((0, 4)))
    return make_pose(rng.uniform(-2.0, 2.0, (n, 3)), quaternion)


def pair(path, turn):
    """Return a start and a goal that lie a path (metres) and a rotation vector (rad) apart."""
    start = make_pose(ORIGIN, Rotation.from_rotvec([0.3, -0.2, 0.9]))[np.newaxis]
    goal = make_pose(ORIGIN + path, Rotation.from_rotvec(turn) * rotation(start[0]))[np.newaxis]
    return start, goal


def first_twist(generator, start, goal, dt=DT):
    """Return the twists of the first step, shape (n, 6)."""
    state = generator.start(start, goal, [])
    return generator.twist(state, start, goal, np.full(len(start), dt))[0]


def run(generator, start, goal, duration, dt=DT):
    """Return the poses, shape (steps + 1, n, 7), and the twists, shape (steps, n, 6)."""
    state, poses, twists = generator.start(start, goal, [None] * len(start)), [start], []
    for _ in range(round(duration / dt)):
        twist, state = generator.twist(state, poses[-1], goal, np.full(len(poses[-1]), dt))
        poses.append(integrate(poses[-1], twist, dt))
        twists.append(twist)
    return np.stack(poses), np.stack(twists)


def speeds(twists):
    return np.linalg.norm(twists[..., :3], axis=-1), np.linalg.norm(twists[..., 3:], axis=-1)


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"max_angular_velocity": None},
        {"max_velocity": 0.05, "max_angular_velocity": 0.3},
        {"gain": 1.0, "min_velocity": 0.02},
    ],
)
def test_keeps_the_contract(parameters):
    limit = parameters.get("max_angular_velocity", 0.1)
    check_motion_generator(Linear(**parameters), max_angular_velocity=limit)


@given(seeds)
@settings(max_examples=10)
def test_arrives_exactly_and_stays(seed):
    start, goal = random_poses(6, seed), random_poses(6, seed + 1)
    poses, twists = run(Linear(), start, goal, 130.0)
    metres, radians = distance(poses[-1], goal)
    assert metres.max() < 1e-12
    assert radians.max() < 1e-12
    assert np.abs(twists[-1]).max() < 1e-12


@given(seeds)
@settings(max_examples=10)
def test_follows_the_straight_line_and_the_slerp_in_step(seed):
    start, goal = random_poses(1, seed), random_poses(1, seed + 1)
    poses, _ = run(Linear(), start, goal, 120.0)
    whole = np.linalg.norm(goal[0, :3] - start[0, :3])
    covered = np.linalg.norm(poses[:, 0, :3] - start[0, :3], axis=-1) / whole
    assert np.all(np.diff(covered) >= -1e-12)
    line = start[0, :3] + covered[:, np.newaxis] * (goal - start)[0, :3]
    assert np.allclose(poses[:, 0, :3], line, atol=1e-12)
    ends = Rotation.from_quat([start[0, 3:], goal[0, 3:]])
    on_the_way = Slerp([0.0, 1.0], ends)(np.clip(covered, 0.0, 1.0))
    assert (on_the_way.inv() * rotation(poses[:, 0])).magnitude().max() < 1e-7


@given(seeds, st.sampled_from([0.02, 0.1, 0.5]))
@settings(max_examples=10)
def test_keeps_its_limits_and_never_moves_away(seed, dt):
    start, goal = random_poses(6, seed), random_poses(6, seed + 1)
    poses, twists = run(Linear(), start, goal, 60.0, dt)
    linear, angular = speeds(twists)
    assert linear.max() <= 0.1 * (1.0 + 1e-9)
    assert angular.max() <= 0.1 * (1.0 + 1e-9)
    metres, radians = distance(poses, np.broadcast_to(goal, poses.shape))
    assert np.all(np.diff(metres, axis=0) <= 1e-12)
    assert np.all(np.diff(radians, axis=0) <= 1e-12)


def test_speed_follows_the_distance():
    path = np.array([3.0, 0.0, 0.0])
    for metres, speed in ((3.0, 0.1), (1.0, 0.1), (0.5, 0.05), (0.05, 0.005), (0.004, 0.001)):
        start, goal = pair(path * metres / 3.0, np.zeros(3))
        twist = first_twist(Linear(), start, goal)
        assert np.allclose(twist, [[speed, 0.0, 0.0, 0.0, 0.0, 0.0]], atol=1e-12)


def test_last_metre_takes_37_seconds():
    start, goal = pair(np.array([0.0, 1.0, 0.0]), np.zeros(3))
    poses, _ = run(Linear(), start, goal, 60.0)
    metres = distance(poses[:, 0], np.broadcast_to(goal[0], poses[:, 0].shape))[0]
    assert np.argmax(metres < 0.025) * DT == pytest.approx(37.0, abs=0.5)


@given(seeds)
@settings(max_examples=5)
def test_time_to_the_goal_does_not_depend_on_dt(seed):
    start, goal = random_poses(4, seed), random_poses(4, seed + 1)
    fine, coarse = (run(Linear(), start, goal, 40.0, dt)[0] for dt in (0.02, 0.1))
    metres, radians = distance(fine[::5], coarse)
    assert metres.max() < 0.01
    assert radians.max() < 0.02


def test_angular_limit_slows_the_whole_motion():
    start, goal = pair(np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.0, 2.0]))
    limited = first_twist(Linear(), start, goal)
    free = Linear(max_angular_velocity=None)
    unlimited = first_twist(free, start, goal)
    assert np.allclose(limited, [[0.025, 0.0, 0.0, 0.0, 0.0, 0.1]])
    assert np.allclose(unlimited, [[0.05, 0.0, 0.0, 0.0, 0.0, 0.2]])


@pytest.mark.parametrize("metres", [0.0, 1e-17, 1e-12, 1e-7, 2e-6, 1e-4, 0.01])
@pytest.mark.parametrize("radians", [0.0, 1e-9, 0.005, 1.0, 3.1, np.pi])
def test_arrives_over_tiny_paths_with_large_turns(metres, radians):
    start, goal = pair(np.array([0.0, 0.6, 0.8]) * metres, np.array([0.0, 0.0, 1.0]) * radians)
    poses, twists = run(Linear(), start, goal, 90.0)
    left, turn_left = distance(poses[-1], goal)
    assert left[0] < 1e-12
    assert turn_left[0] < 1e-12
    linear, angular = speeds(twists)
    assert linear.max() <= 0.1 * (1.0 + 1e-9)
    assert angular.max() <= 0.1 * (1.0 + 1e-9)


def test_turn_on_the_spot_slows_down_as_a_path_does():
    for radians, speed in ((2.0, 0.1), (0.5, 0.05), (0.004, 0.001)):
        start, goal = pair(np.zeros(3), np.array([0.0, 0.0, radians]))
        twist = first_twist(Linear(), start, goal)
        assert np.allclose(twist, [[0.0, 0.0, 0.0, 0.0, 0.0, speed]], atol=1e-12)


def test_half_a_turn_keeps_its_direction():
    start, goal = pair(np.array([0.4, 0.0, 0.0]), np.array([np.pi, 0.0, 0.0]))
    poses, twists = run(Linear(), start, goal, 100.0)
    turning = twists[:, 0, 3:][speeds(twists)[1][:, 0] > 1e-6]
    assert np.all(turning @ turning[0] > 0.0)
    assert distance(poses[-1], goal)[1][0] < 1e-12


def test_is_at_rest_at_the_goal():
    pose = random_poses(3, 0)
    twist = first_twist(Linear(), pose, pose)
    assert np.abs(twist).max() < 1e-12


@given(seeds)
def test_either_sign_of_a_quaternion_is_the_same_orientation(seed):
    start, goal = random_poses(3, seed), random_poses(3, seed + 1)
    signs = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0])
    generator = Linear()
    twist = first_twist(generator, start, goal)
    flipped = first_twist(generator, start * signs, goal * signs)
    other = first_twist(generator, start * signs, goal)
    assert np.allclose(twist, flipped, atol=1e-9)
    assert np.allclose(twist, other, atol=1e-9)


@given(seeds)
@settings(max_examples=20)
def test_heads_straight_for_the_goal_when_displaced(seed):
    start, goal = random_poses(4, seed), random_poses(4, seed + 1)
    displaced = random_poses(4, seed + 2)
    generator = Linear()
    twist, _ = generator.twist(
        generator.start(start, goal, []), displaced, goal, np.full(len(displaced), DT)
    )
    way = twist_between(displaced, goal, 1.0)
    execution = np.linalg.norm(twist, axis=-1) / np.linalg.norm(way, axis=-1)
    assert np.allclose(twist, way * execution[:, np.newaxis])
    linear, angular = speeds(twist)
    assert max(linear.max(), angular.max()) <= 0.1 * (1.0 + 1e-9)


def test_a_row_has_the_same_bits_in_any_batch():
    start, goal = random_poses(37, 0), random_poses(37, 1)
    start[5] = goal[5]
    poses, twists = run(Linear(), start, goal, 5.0)
    for rows in (slice(0, 1), slice(5, 6), slice(36, 37), slice(3, 20), slice(0, 37, 3)):
        some_poses, some_twists = run(Linear(), start[rows], goal[rows], 5.0)
        assert np.array_equal(some_poses, poses[:, rows])
        assert np.array_equal(some_twists, twists[:, rows])


def test_no_motions_are_motions_too():
    none = np.zeros((0, 7))
    state = Linear().start(none, none, [])
    twist, state = Linear().twist(state, none, none, np.full(len(none), DT))
    assert twist.shape == (0, 6)
    assert Linear().goal_pose(state, none).shape == (0, 7)


def test_never_passes_the_goal_in_a_long_step():
    start, goal = pair(np.array([1e-3, 0.0, 0.0]), np.array([0.0, 0.0, 0.05]))
    twist = first_twist(Linear(), start, goal, 10.0)
    metres, radians = distance(integrate(start, twist, 10.0), goal)
    assert max(metres[0], radians[0]) < 1e-12


def test_keeps_no_hold_of_what_it_is_given():
    start, goal = random_poses(2, 0), random_poses(2, 1)
    state, expected = Linear().start(start, goal, []), goal.copy()
    Linear().goal_pose(state, goal)[:] = 0.0
    assert np.array_equal(goal, expected)
    assert not state


def test_heads_for_the_target_where_it_is_now():
    start, goal = pair(np.array([1.0, 0.0, 0.0]), np.zeros(3))
    moved = goal + np.array([-1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    twist, _ = Linear().twist(Linear().start(start, goal, []), start, moved, np.full(1, DT))
    assert np.array_equal(twist, first_twist(Linear(), start, moved))
    assert np.array_equal(Linear().goal_pose({}, moved), moved)


@pytest.mark.parametrize("name", ["gain", "min_velocity", "max_velocity", "max_angular_velocity"])
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, np.inf, "fast", True])
def test_refuses_numbers_that_are_not_positive(name, value):
    with pytest.raises(KinfeasError, match=f"^{name} must be a positive number, not "):
        Linear(**{name: value})


def test_refuses_limits_out_of_order():
    with pytest.raises(KinfeasError, match=r"^min_velocity must be at most max_velocity, 0.1, not"):
        Linear(min_velocity=0.2)


def test_takes_keywords_only():
    kinds = {p.kind for p in inspect.signature(Linear).parameters.values()}
    assert kinds == {inspect.Parameter.KEYWORD_ONLY}


def test_a_step_costs_no_python_loop_over_rows():
    generator, poses = Linear(), random_poses(1280, 0)
    seconds = []
    for n in (128, 1280):
        state = generator.start(poses[:n], poses[::-1][:n], [])
        began = time.perf_counter()
        for _ in range(20):
            generator.twist(state, poses[:n], poses[::-1][:n], np.full(len(poses[:n]), DT))
        seconds.append((time.perf_counter() - began) / 20)
    assert seconds[0] < 0.005
    assert seconds[1] < 0.05
