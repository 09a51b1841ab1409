from dataclasses import replace

import numpy as np

from kinfeas.core.motion import WholeBodyPath
from kinfeas.core.solids import Solids, stacked_solids
from kinfeas.core.spatial import distance
from kinfeas.plugins.minimum_jerk import MinimumJerk
from kinfeas.plugins.planned import Planned, RandomSpline, WholeBody
from kinfeas.testing import check_motion_generator
from tests.builders import random_poses
from tests.plugins.conftest import DT, run, speeds

RADIUS = 0.15


def clearance(solids, row, points):
    """Return the distances of points, shape (m, 3), to the nearest solid."""
    return np.hypot(*solids.of(np.array([row])).gaps(points[np.newaxis]))[0].min(axis=1)


def world(seed, places=40):
    """Return solids, a start and a goal that are free of them, of one row."""
    rng = np.random.default_rng(seed)
    solids = Solids.empty(1, places)
    solids.pose[0] = rng.uniform([-5.0, -5.0, -np.pi], [5.0, 5.0, np.pi], (places, 3))
    solids.size[0, :, :2] = rng.uniform(0.1, 0.6, (places, 2))
    solids.size[0, :, 3] = rng.choice([0.2, 0.7, 2.0], places)
    solids.cylinder[0] = rng.random(places) < 0.3
    solids.size[0, :, 1][solids.cylinder[0]] = solids.size[0, :, 0][solids.cylinder[0]]
    poses = []
    while len(poses) < 2:
        pose = random_poses(1, int(rng.integers(2**31)))
        pose[:, :3] = rng.uniform([-4.0, -4.0, 0.4], [4.0, 4.0, 1.2])
        if clearance(solids, 0, pose[:, :3])[0] > 0.35:
            poses.append(pose)
    return solids, *poses


def worlds(n):
    solids, starts, goals = zip(*(world(seed) for seed in range(n)), strict=True)
    return stacked_solids(solids), np.concatenate(starts), np.concatenate(goals)


def planned(solids, start, goal):
    generator = Planned(radius=RADIUS)
    state = generator.start(start, goal, [None] * len(start))
    return generator, generator.replan(state, start, goal, solids)


def test_paths_keep_clear_arrive_and_are_smooth():
    solids, start, goal = worlds(16)
    generator, state = planned(solids, start, goal)
    poses, twists, _ = run(generator, start, goal, 250.0, state=state)
    assert np.max(distance(poses[-1], goal)) < 1e-6
    assert max(map(np.max, speeds(twists))) <= 0.1 * (1.0 + 1e-9)
    for row in range(16):
        assert clearance(solids, row, poses[:, row, :3]).min() >= RADIUS
    ways = distance(poses[:-1], poses[1:])[0].sum(axis=0)
    assert np.sum(ways > 1.01 * distance(start, goal)[0]) > 3
    linear, angular = speeds(np.diff(twists, axis=0, prepend=0.0) / DT)
    assert max(linear.max(), angular.max()) < 0.15  # m/s^2, rad/s^2


def test_plans_are_the_same_to_the_bit_alone_and_in_a_batch():
    solids, start, goal = worlds(8)
    generator, state = planned(solids, start, goal)
    for row in range(8):
        one = np.array([row])
        _, alone = planned(solids.of(one), start[one], goal[one])
        for key, values in alone.items():
            np.testing.assert_array_equal(values[0], state[key][row], err_msg=key)
        ahead = generator.ahead(alone, start[one], goal[one], np.array([0.5, 1.5]))
        whole = generator.ahead(state, start, goal, np.array([0.5, 1.5]))
        np.testing.assert_array_equal(ahead[0], whole[row])


def across(high, half=3.0, at=1.5):
    """Return a solid across the way from x = 0 to 3, and start and goal."""
    solids = Solids.empty(1, 1)
    solids.pose[0, 0, 0], solids.size[0, 0] = at, [0.05, half, 0.0, high]
    start, goal = np.tile([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0], (2, 1, 1))
    goal[0, 0] = 3.0
    return solids, start, goal


def test_without_solids_the_motion_is_that_of_minimum_jerk():
    start, goal = random_poses((2, 5), reach=2.0)
    expected = run(MinimumJerk(), start, goal, 60.0)[0]
    np.testing.assert_allclose(run(Planned(), start, goal, 60.0)[0], expected, atol=1e-9)


def test_free_motions_are_straight_and_low_solids_are_passed_above():
    points = planned(*across(0.1, at=50.0))[1]["points"][0]
    np.testing.assert_allclose(points[:, 1:3], np.tile([0.0, 0.5], (64, 1)), atol=1e-12)
    points = planned(*across(0.6))[1]["points"][0]
    assert points[:, 2].max() > 0.75
    assert np.abs(points[:, 1]).max() < 0.1
    points = planned(*across(2.0))[1]["points"][0]
    assert np.abs(points[:, 1]).max() > 3.0


def test_ends_beside_a_solid_are_left_and_reached():
    solids, start, goal = across(2.0, at=2.93)
    goal[:, 0] = 3.03
    generator, state = planned(solids, start, goal)
    poses, _, _ = run(generator, start, goal, 150.0, state=state)
    assert np.max(distance(poses[-1], goal)) < 1e-6
    near = clearance(solids, 0, poses[:, 0, :3]) < RADIUS
    assert distance(poses[near], goal)[0].max() < 0.4


def test_a_new_plan_begins_with_the_velocity_of_the_old_one():
    solids, start, goal = across(2.0)
    generator, state = planned(solids, start, goal)
    other = across(2.0)[0]
    other.pose[0, 0, 1] = -2.5  # the short way is on the other side now

    def replanned(i, state, ee):
        return generator.replan(state, ee, goal, other) if i == 60 else state

    poses, twists, _ = run(generator, start, goal, 200.0, state=state, on_step=replanned)
    assert poses[:, 0, 1].max() > 0.4
    assert clearance(other, 0, poses[:, 0, :3]).min() > RADIUS
    linear, _ = speeds(np.diff(twists, axis=0) / DT)
    assert linear.max() < 0.25
    assert np.max(distance(poses[-1], goal)) < 1e-6


def test_splines_are_random_smooth_and_within_their_spread():
    generator = RandomSpline(spread=0.4)
    start, goal = np.zeros((20, 7)), np.zeros((20, 7))
    start[:, 6], goal[:, 6], goal[:, 0] = 1.0, 1.0, 3.0
    state = generator.start(start, goal, [np.random.default_rng(i) for i in range(20)])
    poses, twists, _ = run(generator, start, goal, 100.0, state=state)
    assert np.max(distance(poses[-1], goal)) < 1e-6
    middle = np.abs(poses[..., :3] - start[:, :3]).max(axis=0)[:, 1:]
    assert np.all(middle.max(axis=0) < [0.8, 0.3])
    assert middle[:, 0].std() > 0.05
    assert speeds(np.diff(twists, axis=0, prepend=0.0) / DT)[0].max() < 0.25


def along(k=30):
    """Return start and goal of one motion, and a whole-body path around a corner."""
    share = np.linspace(0.0, 1.0, k)[:, np.newaxis]
    ee = np.tile([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0], (k, 1))
    ee[:, :2] = np.where(share < 0.5, [2.0, 0.0] * share, [1.0, -1.0] + [0.0, 2.0] * share)
    robot = np.column_stack([ee[:, :2] - [0.6, 0.0], 0.5 * share, 2.0 * share])
    return ee[:1], ee[-1:], WholeBodyPath(ee, robot, np.full(k - 1, 0.1))


def test_whole_body_motions_follow_their_path_with_the_robot_ahead():
    check_motion_generator(WholeBody())
    start, goal, path = along()
    generator, seconds = WholeBody(), np.array([0.0, 1.0])
    state = generator.start(start, goal, [None])
    state, waypoints = generator.follow(state, start, goal, [path])
    robots = [generator.robot_ahead(state, waypoints, seconds)[0]]
    np.testing.assert_allclose(robots[0][0], path.robot[0], atol=1e-9)

    def watch(i, state, ee):
        robots.append(generator.robot_ahead(state, waypoints, seconds)[0])
        return state

    poses, twists, _ = run(generator, start, goal, 60.0, state=state, on_step=watch)
    assert np.max(distance(poses[-1], goal)) < 1e-6
    assert max(map(np.max, speeds(twists))) <= 0.1 * (1.0 + 1e-9)
    off = np.linalg.norm(poses[:, 0, np.newaxis, :3] - path.ee[:, :3], axis=2).min(axis=1)
    assert off.max() < 0.05
    robots = np.array(robots[1:])
    np.testing.assert_allclose(robots[-1], path.robot[[-1, -1]], atol=1e-6)
    np.testing.assert_allclose(robots[:-10, 1], robots[10:, 0], atol=1e-9)
    np.testing.assert_allclose(robots[:, 0, :2], poses[1:, 0, :2] - [0.6, 0.0], atol=0.02)
    np.testing.assert_allclose(robots[:, 0, 3], 4.0 * robots[:, 0, 2], atol=1e-9)


def test_slow_base_paths_take_their_time():
    start, goal, path = along()
    generator, both = WholeBody(), (np.tile(start, (2, 1)), np.tile(goal, (2, 1)))
    state = generator.start(*both, [None, None])
    slow = replace(path, seconds=np.full(29, 5.0))
    begun, waypoints = generator.follow(state, *both, [slow, path])
    assert begun["duration"][0] > 145.0 > 2.0 * begun["duration"][1]
    waypoints[1] = np.nan
    ahead = generator.robot_ahead(begun, waypoints, np.zeros(1))
    np.testing.assert_array_equal(np.isnan(ahead).all(axis=(1, 2)), [False, True])


def test_a_radius_above_the_clearance_needs_no_other_plan():
    solids, start, goal = across(1.0, half=0.1)
    solids.pose[0, 0, 1], solids.velocity[0, 0, 0], solids.span[0, 0] = 2.5, 0.01, 1.0
    generator = Planned(radius=0.3, clearance=0.2)
    state = generator.replan(generator.start(start, goal, [None]), start, goal, solids)
    _, state = generator.twist(state, start, goal, np.array([2.0]))
    again = generator.replan(state, start, goal, solids)
    np.testing.assert_array_equal(again["time"], state["time"])


def test_whole_body_paths_stay_where_those_of_the_ee_are_replanned():
    solids, start, goal = across(2.0)
    generator = WholeBody()
    state = generator.start(start, goal, [None])
    around = generator.replan(state, start, goal, solids)
    assert np.abs(around["points"][0, :, 1]).max() > 3.0
    path = along()[2]
    state, _ = generator.follow(state, start, goal, [path])
    np.testing.assert_array_equal(
        generator.replan(state, start, goal, solids)["points"], state["points"]
    )
