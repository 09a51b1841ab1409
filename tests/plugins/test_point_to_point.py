import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.spatial import IDENTITY, distance, integrate, make_pose, rotation, twist_between
from kinfeas.plugins.linear import Linear
from kinfeas.plugins.minimum_jerk import MinimumJerk
from kinfeas.plugins.servo import Servo
from tests.builders import assert_near, random_poses
from tests.plugins.conftest import DT, run, speeds, starts_and_targets


def pair(path, turn):
    """Return a start and a goal that are a path (metres) and a rotation vector (rad) apart."""
    start = make_pose(np.array([0.3, -1.0, 0.7]), Rotation.from_rotvec([0.3, -0.2, 0.9]))
    goal = make_pose(start[:3] + path, Rotation.from_rotvec(turn) * rotation(start))
    return start[np.newaxis], goal[np.newaxis]


def test_linear_follows_the_straight_line_and_the_slerp_in_step():
    start, goal = starts_and_targets(20, 0)
    poses, _, _ = run(Linear(), start, goal, 120.0)
    whole = np.linalg.norm((goal - start)[:, :3], axis=-1)
    covered = np.linalg.norm((poses - start)[..., :3], axis=-1) / whole
    assert np.all(np.diff(covered, axis=0) >= -1e-12)
    way = covered[..., np.newaxis] * twist_between(start, goal, 1.0)
    assert_near(poses, integrate(start, way, 1.0), 1e-12, 1e-7)


@pytest.mark.parametrize(("metres", "radians", "twist"), [
    (3.0, 0.0, (0.1, 0.0)), (0.5, 0.0, (0.05, 0.0)), (0.004, 0.0, (0.001, 0.0)),
    (0.5, 2.0, (0.025, 0.1)), (0.0, 2.0, (0.0, 0.1)), (0.0, 0.5, (0.0, 0.05)),
    (0.0, 0.004, (0.0, 0.001)),
])  # fmt: skip
def test_linear_speed_follows_distance_and_angle(metres, radians, twist):
    start, goal = pair(np.array([metres, 0.0, 0.0]), np.array([0.0, 0.0, radians]))
    expected = [[[twist[0], 0.0, 0.0, 0.0, 0.0, twist[1]]]]
    assert np.allclose(run(Linear(), start, goal, DT)[1], expected, atol=1e-12)


@pytest.mark.parametrize("metres", [0.0, 1e-17, 1e-7, 2e-6, 0.01])
@pytest.mark.parametrize("radians", [0.0, 1e-9, 0.005, np.pi])
def test_linear_arrives_over_tiny_paths_with_large_turns(metres, radians):
    start, goal = pair(np.array([0.0, 0.6, 0.8]) * metres, np.array([0.0, 0.0, 1.0]) * radians)
    poses, twists, _ = run(Linear(), start, goal, 90.0)
    assert np.max(distance(poses[-1], goal)) < 1e-12
    assert max(map(np.max, speeds(twists))) <= 0.1 * (1.0 + 1e-9)
    if radians:  # half a turn keeps its direction
        turning = twists[:, 0, 3:][speeds(twists)[1][:, 0] > 1e-6]
        assert np.all(turning @ turning[:1].T > 0.0)


def test_minimum_jerk_follows_the_quintic_in_the_shortest_time():
    goal = np.array([[0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    poses, _, state = run(MinimumJerk(), IDENTITY[np.newaxis], goal, 10.0)
    assert state["duration"] == pytest.approx(1.875 * 0.4 / 0.1)
    s = np.minimum(np.arange(len(poses)) * DT / state["duration"], 1.0)
    expected = 0.4 * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    assert np.allclose(poses[:, 0, 0], expected, atol=1e-12)
    short = MinimumJerk(min_duration=3.0).start(IDENTITY[np.newaxis], goal * 1e-4, [])
    assert short["duration"] == 3.0


def test_minimum_jerk_waits_for_an_ee_that_is_held():
    start, target = starts_and_targets(4, 2)
    generator = MinimumJerk()
    state = generator.start(start, target, [])
    held = start + np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(100):
        twist, state = generator.twist(state, held, target, np.full(4, DT))
    assert state["time"].max() < 0.5
    back = twist_between(held, start, 1.0)
    assert np.all(np.sum(twist[:, :3] * back[:, :3], axis=1) > 0.0)


LIMITS = {
    "max_velocity": 0.2, "max_acceleration": 2.0, "max_jerk": 60.0,
    "max_angular_velocity": 0.5, "max_angular_acceleration": 6.0, "max_angular_jerk": 150.0,
}  # fmt: skip


def follow(motion, pose, targets, dt):
    """Return poses (t, n, 7) and velocities (t, n, 6) at the ends of steps toward targets."""
    state, paths, velocities = motion.start(pose, targets[0], []), [], []
    for target, seconds in zip(targets, dt, strict=True):
        twist, state = motion.twist(state, pose, target, seconds)
        pose = spatial.integrate(pose, twist, seconds)
        paths.append(pose)
        velocities.append(state["velocity"])
    return np.array(paths), np.array(velocities)


@given(seed=st.integers(0, 2**32 - 1), hold=st.integers(1, 20))
@settings(max_examples=25, deadline=None)
def test_velocity_acceleration_and_jerk_stay_within_their_limits(seed, hold):
    """Also where targets jump, and where each row slows down by itself."""
    n, steps, dt = 20, 100, 1e-3
    start, *targets = random_poses((steps + 1, n), seed)
    targets = np.repeat(targets, hold, axis=0)[:steps]
    _, velocity = follow(Servo(**LIMITS), start, targets, np.full((steps, n), dt))
    velocity = np.concatenate([np.zeros((2, n, 6)), velocity])
    for part, kind in ((velocity[..., :3], ""), (velocity[..., 3:], "angular_")):
        for order, name in enumerate(("velocity", "acceleration", "jerk")):
            size = np.linalg.norm(np.diff(part, order, axis=0), axis=2) / dt**order
            assert size.max() <= LIMITS[f"max_{kind}{name}"] * (1.0 + 1e-6), name


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_an_ee_stays_within_a_box_of_targets_and_reaches_the_last_one(seed):
    n, steps = 10, 600
    start, *targets = random_poses((7, n), seed)
    targets = np.repeat(targets, steps // 6, axis=0)
    targets[steps // 3 :] = targets[-1]
    dt = np.random.default_rng(seed).uniform(0.001, 0.3, (steps, n))
    paths, _ = follow(Servo(**LIMITS), start, targets, dt)
    box = np.concatenate([start[np.newaxis], targets])
    assert np.all(paths[..., :3] >= box.min(axis=0)[:, :3] - 1e-9)
    assert np.all(paths[..., :3] <= box.max(axis=0)[:, :3] + 1e-9)
    assert_near(paths[-1], targets[-1], 1e-4, 1e-3)


def test_a_motion_does_not_depend_on_the_control_rate():
    """A command that both rates limit to the same velocity leads to the same pose."""
    start = random_poses(5)
    target = start + np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    ends = [
        follow(Servo(**LIMITS), start, np.array([target] * n), np.full((n, 5), 1.0 / n))[0][-1]
        for n in (10, 50)
    ]
    np.testing.assert_allclose(*ends, atol=1e-9)


@pytest.mark.parametrize("lookahead", [0.0, 2.0])
def test_the_goal_lies_ahead_of_a_moving_target(lookahead):
    motion, pose = Servo(**LIMITS, lookahead=lookahead), spatial.IDENTITY[np.newaxis]
    target = pose + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    state = motion.start(pose, target, [])
    for _ in range(10):
        twist, state = motion.twist(state, pose, target, np.array([0.1]))
    ahead = motion.goal_pose(state, target)[0, 0] - 1.0
    assert ahead == pytest.approx(twist[0, 0] * lookahead, abs=1e-3)
