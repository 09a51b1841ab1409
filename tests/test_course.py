from dataclasses import replace

import numpy as np
import pytest

from kinfeas import spatial
from kinfeas.course import Course
from kinfeas.legs import LegMotion, Pace, tool_pose
from kinfeas.observation import HORIZON
from kinfeas.plugins.linear import Linear


class Wander:
    """Moves toward a point near the target that it draws, and counts; the base was shown, too."""

    def start(self, ee_pose, target_pose, rngs):
        goal = target_pose.copy()
        goal[:, :3] += np.array([rng.uniform(-0.1, 0.1, 3) for rng in rngs])
        return {"goal": goal, "count": np.zeros(len(goal)), "begin": ee_pose.copy()}

    def goal_pose(self, state):
        return state["goal"].copy()

    def twist(self, state, ee_pose, dt):
        way = spatial.twist_between(ee_pose, state["goal"], 1.0)
        return 0.5 * way, {**state, "count": state["count"] + 1.0}

    def base_pose(self, state):
        pose = np.tile(spatial.IDENTITY, (len(state["count"]), 1))
        pose[:, 0] = state["count"]
        return pose


def rngs(rows, seed=0):
    return [np.random.default_rng((seed, row)) for row in rows]


def poses(n, seed=0):
    rng = np.random.default_rng(seed)
    pose = np.concatenate([rng.uniform(-1.0, 1.0, (n, 3)), rng.normal(size=(n, 4))], axis=1)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    pose[:, 3:] = spatial.canonical(pose[:, 3:])
    return pose


def chain():
    """Return four legs of two generators and both frames, with and without a wait."""
    linear = Linear()
    return [
        LegMotion(linear, "tip"),
        LegMotion(Wander(), "ee", wait=0.3),
        LegMotion(linear, "ee"),
        LegMotion(linear, "tip", wait=5.0),
    ]


def begin(robot, n=6, legs=None, dt=HORIZON):
    legs = chain() if legs is None else legs
    course = Course(legs, robot, dt)
    course.start(poses(n), poses(n * len(legs), 1).reshape(n, len(legs), 7), rngs(range(n)))
    return course


def follow(course, steps, arrived=None):
    """Move on, arriving where a row is near or as told, and return all desired poses."""
    seen = []
    for i in range(steps):
        course.move(course.ahead(HORIZON))
        metres, radians = spatial.distance(course.desired, course.goal)
        near = (metres < 0.02) & (radians < 0.2)
        course.advance(near if arrived is None else arrived(i))
        seen.append(course.desired)
    return np.stack(seen)


def everyone(course):
    return np.ones(len(course.leg), dtype=bool)


def test_tool_tip_is_ahead_along_the_approach_axis(robot):
    tool = tool_pose(robot)
    approach = spatial.rotation(tool).as_matrix()[:, 0]
    np.testing.assert_allclose(robot.tool_tip, np.linalg.norm(robot.tool_tip) * approach, atol=1e-9)
    gripper = spatial.compose(np.array([*np.zeros(3), *robot.gripper_rotation]), tool)
    np.testing.assert_allclose(np.abs(gripper[6]), 1.0, atol=1e-9)


def test_tip_legs_lead_the_tip_to_the_target(robot):
    course = begin(robot, legs=[LegMotion(Linear(), "tip")])
    target = poses(6, 1)
    tip = spatial.compose(course.goal, np.broadcast_to(tool_pose(robot), (6, 7)))
    np.testing.assert_allclose(np.stack(spatial.distance(tip, target)), 0.0, atol=1e-7)
    follow(course, 600)
    assert np.all(spatial.distance(course.desired, course.goal)[0] < 0.02)


def test_the_tip_moves_straight_and_takes_the_ee_along(robot):
    course, linear = begin(robot, legs=[LegMotion(Linear(), "tip")]), Linear()
    tool = np.broadcast_to(tool_pose(robot), (6, 7))
    tip = spatial.compose(course.desired, tool)
    state = linear.start(tip, poses(6, 1), rngs(range(6)))
    for _ in range(100):
        twist, state = linear.twist(state, tip, HORIZON)
        tip = spatial.integrate(tip, twist, HORIZON)
        course.move(course.ahead(HORIZON))
        error = spatial.distance(spatial.compose(course.desired, tool), tip)
        np.testing.assert_allclose(np.stack(error), 0.0, atol=1e-6)


def test_looking_ahead_moves_nothing(robot):
    course = begin(robot)
    follow(course, 40)
    before = course.snapshot()
    first, second = course.ahead(HORIZON), course.ahead(HORIZON)
    np.testing.assert_array_equal(first[0], second[0])
    for key, values in course.snapshot().items():
        np.testing.assert_array_equal(values, before[key], err_msg=key)


def test_legs_follow_each_other_from_the_desired_pose(robot):
    course = begin(robot, 1)
    legs, last = [0], course.desired
    for _ in range(3000):
        course.move(course.ahead(HORIZON))
        assert np.linalg.norm(course.desired[:, :3] - last[:, :3]) < 0.1  # never a leap
        metres, radians = spatial.distance(course.desired, course.goal)
        course.advance((metres < 0.02) & (radians < 0.2))
        legs.append(int(course.leg[0]))
        last = course.desired
    assert sorted(set(legs)) == [0, 1, 2, 3]
    assert np.all(np.diff(legs) >= 0)
    assert course.last.all()


@pytest.mark.parametrize(("dt", "periods"), [(0.1, 20), (0.02, 100), (0.3, 7)])
def test_a_wait_stands_still_for_its_seconds(robot, dt, periods):
    linear = Linear()
    course = begin(robot, 2, [LegMotion(linear, wait=2.0), LegMotion(linear)], dt)
    course.move(course.ahead(dt))
    course.advance(np.array([True, False]))
    assert course.waiting.tolist() == [periods, 0]
    stood = course.desired[0]
    for i in range(periods):
        assert course.leg[0] == 0
        np.testing.assert_array_equal(course.ahead(HORIZON)[0][0], stood)
        before = course.desired
        course.move(course.ahead(dt))
        np.testing.assert_array_equal(course.desired[0], stood)
        assert np.linalg.norm(course.desired[1] - before[1]) > 0.0
        course.advance(np.array([i % 2 == 0, False]))
    assert course.leg.tolist() == [1, 0]
    course.move(course.ahead(dt))
    assert np.linalg.norm(course.desired[0] - stood) > 0.0


def test_the_wait_of_the_last_leg_does_not_hold_it(robot):
    course = begin(robot, 3, [LegMotion(Linear(), wait=2.0)])
    course.advance(everyone(course))
    assert course.last.all()
    assert not course.waiting.any()


def test_no_row_depends_on_the_others(robot):
    together = begin(robot, 6)
    expected = follow(together, 900)
    assert np.all(together.leg > 0)
    for rows in ([4], [5, 0, 2]):
        course = Course(chain(), robot, HORIZON)
        course.start(poses(6)[rows], poses(24, 1).reshape(6, 4, 7)[rows], rngs(rows))
        np.testing.assert_array_equal(follow(course, 900), expected[:, rows])


def test_a_restart_is_the_same_in_any_row_and_touches_no_other(robot):
    whole, other = begin(robot, 6), begin(robot, 6)
    follow(whole, 300)
    follow(other, 300)
    held = other.snapshot()
    copies = {key: values.copy() for key, values in held.items()}
    rows = np.array([3, 1])
    other.start(poses(6)[[0, 5]], poses(24, 1).reshape(6, 4, 7)[[0, 5]], rngs([0, 5]), rows)
    for key, values in held.items():
        np.testing.assert_array_equal(values, copies[key], err_msg=key)
    kept = [0, 2, 4, 5]
    seen = follow(other, 300)
    np.testing.assert_array_equal(seen[:, kept], follow(whole, 300)[:, kept])
    np.testing.assert_array_equal(seen[:, rows], follow(begin(robot, 6), 300)[:, [0, 5]])


def test_randomness_differs_between_rows_and_legs(robot):
    legs = [LegMotion(Wander()), LegMotion(Wander())]
    course = Course(legs, robot, HORIZON)
    course.start(poses(2), np.tile(spatial.IDENTITY, (2, 2, 1)), rngs(range(2)))
    first = course.goal
    course.advance(everyone(course))
    assert len(np.unique(np.concatenate([first, course.goal])[:, 0])) == 4


@pytest.mark.parametrize("steps", [1, 250, 700])
def test_snapshot_goes_on_to_the_bit(robot, steps):
    course, again = begin(robot), Course(chain(), robot, HORIZON)
    follow(course, steps)
    again.restore(course.snapshot())
    for key in ("leg", "waiting", "goal", "demonstrated_base"):
        np.testing.assert_array_equal(getattr(again, key), getattr(course, key))
    np.testing.assert_array_equal(follow(again, 500), follow(course, 500))


def test_the_demonstrated_base_is_known_on_its_legs_only(robot):
    course = begin(robot, 3, [LegMotion(Wander()), LegMotion(Linear())])
    follow(course, 5, lambda _: np.array([False, True, False]))
    base = course.demonstrated_base
    np.testing.assert_array_equal(base[[0, 2], 0], 5.0)
    assert np.isnan(base[1]).all()


def test_without_demonstrations_there_is_no_base(robot):
    base = begin(robot, 3, [LegMotion(Linear())]).demonstrated_base
    assert base.shape == (3, 7)
    assert np.isnan(base).all()


def test_legs_may_share_a_generator(robot):
    linear = Linear()
    legs = [LegMotion(linear), replace(LegMotion(linear), frame="tip")]
    assert len(Course(legs, robot, HORIZON).generators) == 1
    assert len(Course(chain(), robot, HORIZON).generators) == 2


def test_a_head_start_delays_the_first_leg_and_no_other(robot):
    legs = [LegMotion(Linear(), wait=0.2), LegMotion(Linear())]
    course = Course(legs, robot, HORIZON, Pace(head_start=0.5))
    targets = np.repeat(poses(2, 1)[:, np.newaxis], 2, axis=1)
    course.start(poses(2), targets, rngs(range(2)))
    seen = follow(course, 8, lambda i: np.array([i == 6, False]))
    assert np.all(seen[:5] == poses(2))
    assert np.all(np.any(seen[5] != seen[4], axis=1))
    assert course.waiting.tolist() == [1, 0]
    follow(course, 1, lambda _: np.array([False, False]))
    assert course.leg.tolist() == [1, 0]


def test_a_head_start_is_for_each_episode_alone(robot):
    course = Course([LegMotion(Linear())], robot, HORIZON, Pace(head_start=0.3))
    targets = poses(2, 1)[:, np.newaxis]
    course.start(poses(2), targets, rngs(range(2)))
    follow(course, 3)
    course.start(poses(2)[:1], targets[:1], rngs([0]), np.array([0]))
    before = course.desired
    (after,) = follow(course, 1)
    assert np.all(after[0] == before[0])
    assert np.any(after[1] != before[1])


@pytest.mark.parametrize(("settled_at", "stops_at"), [(2, 2), (0, 0), (99, 4)])
def test_a_leg_that_ends_with_a_grip_goes_on_until_it_settles(robot, settled_at, stops_at):
    legs = [LegMotion(Linear(), wait=0.3, grip="close"), LegMotion(Linear(), grip="open")]
    course = Course(legs, robot, HORIZON, Pace(slow_down=2.0, settle=0.2))
    course.start(poses(1), np.repeat(poses(1, 1)[:, np.newaxis], 2, axis=1), rngs([0]))
    stops, moves = [], []
    for i in range(7):
        before = course.desired
        course.move(course.ahead(HORIZON))
        moves.append(bool(np.any(course.desired != before)))
        stops.append(bool(course.advance(everyone(course), np.array([i >= settled_at]))[0]))
    assert stops == [i == stops_at for i in range(7)]
    assert moves[: stops_at + 4] == ([True] * (stops_at + 1) + [False] * 3)[: len(moves)]


def test_a_leg_without_a_grip_does_not_settle(robot):
    course = Course([LegMotion(Linear(), wait=0.3)] * 2, robot, HORIZON, Pace(settle=1.0))
    course.start(poses(1), np.repeat(poses(1, 1)[:, np.newaxis], 2, axis=1), rngs([0]))
    assert course.advance(everyone(course)).all()
    assert course.stands.all()


def test_rows_that_are_held_stay_where_they_are(robot):
    course, held = begin(robot), np.array([True, False] * 3)
    for leg in range(4):
        before, moves = course.desired, course.ahead(HORIZON)
        course.move(moves, held)
        np.testing.assert_array_equal(course.desired, np.where(held[:, None], before, moves[0]))
        np.testing.assert_array_equal(course.ahead(HORIZON)[0][held], moves[0][held])
        course.advance(everyone(course))
        if leg == 1:
            follow(course, 3)
