import numpy as np
import pytest

from kinfeas.core import registry, spatial
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.recording import record_episodes
from kinfeas.evaluation.waypoints import draw_goals
from kinfeas.kinematics.forward import forward
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.chain import pick_place


def world(max_seconds=6.0):
    robot = load_robot("pr2")
    task = registry.build("kinfeas.tasks", "ggr", {})
    return World(robot, task, WorldConfig(max_failures=99, max_seconds=max_seconds), seed=4)


@pytest.fixture(scope="module")
def recordings():
    place = world()
    return record_episodes(place, FollowEe(place.robot.base), 3, first=5)


def test_each_moment_is_kept(recordings):
    assert [one.episode for one in recordings] == [5, 6, 7]
    for one in recordings:
        moments = len(one.feasible)
        assert one.base_pose.shape == one.desired.shape == one.ee_pose.shape == (moments, 7)
        assert one.joint_positions.shape == (moments, 7)
        assert one.feasible.dtype == np.bool_
        assert one.feasible[0]
        assert 2 <= moments <= 61


def test_they_agree_with_the_tally(recordings):
    place = world()
    records = run_episodes(place, FollowEe(place.robot.base), 3, first=5)
    for row, one in enumerate(recordings):
        assert len(one.feasible) - 1 == records.steps[row]
        assert int(np.sum(~one.feasible)) == records.failures[row]
        deviation = np.linalg.norm(one.ee_pose[1:, :3] - one.desired[1:, :3], axis=1)
        assert deviation.max() == pytest.approx(records.max_deviation[row], abs=1e-12)


def test_the_ee_is_where_the_joints_put_it(recordings):
    chain = world().solver.chain
    for one in recordings:
        expected = spatial.compose(one.base_pose, forward(chain, one.joint_positions))
        np.testing.assert_allclose(one.ee_pose, expected, atol=1e-9)


def test_the_goals_are_those_of_the_legs_begun():
    robot = load_robot("hsr")
    place = World(robot, pick_place(), WorldConfig(max_failures=99), seed=1)
    (one,) = record_episodes(place, FollowEe(robot.base, feedback=True), 1)
    assert one.reached
    np.testing.assert_allclose(one.goals, draw_goals(place.solver, place.task, 1, 1)[0], atol=1e-9)
    np.testing.assert_array_equal(one.goal, one.goals[-1])


def test_a_recorded_episode_is_that_of_the_worlds_stream():
    place = world(max_seconds=0.2)
    place.stream = (1,)
    (one,) = record_episodes(place, FollowEe(place.robot.base), 1, first=5)
    place.start([5])
    np.testing.assert_array_equal(one.base_pose[0], place.loop.state.base_pose[0])
    np.testing.assert_array_equal(one.joint_positions[0], place.loop.state.joint_positions[0])
