import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.reachability import A_SUBGOAL, draw_goals, draw_waypoints
from kinfeas.evaluation.recording import record_episodes
from kinfeas.kinematics.forward import forward
from kinfeas.policies.baselines.following import FollowEe
from kinfeas.tasks.chain_file import pick_place
from kinfeas.tasks.ggr import ggr

TASKS = pytest.mark.parametrize("task", [ggr(), pick_place()], ids=lambda task: task.name)


@pytest.fixture
def world(hsr):
    return World(hsr, ggr(), WorldConfig(max_failures=99, max_seconds=6.0), seed=4)


def test_recordings_agree_with_the_records(world):
    policy = FollowEe(world.robot.base)
    recordings = record_episodes(world, policy, 3, first=5)
    records = run_episodes(world, policy, 3, first=5)
    assert [one.episode for one in recordings] == [5, 6, 7]
    for row, one in enumerate(recordings):
        moments = len(one.feasible)
        assert one.base_pose.shape == one.desired.shape == one.ee_pose.shape == (moments, 7)
        assert one.feasible[0]
        assert moments - 1 == records.steps[row]
        assert int(np.sum(~one.feasible)) == records.failures[row]
        deviation = np.linalg.norm(one.ee_pose[1:, :3] - one.desired[1:, :3], axis=1)
        assert deviation.max() == pytest.approx(records.max_deviation[row], abs=1e-12)
        expected = spatial.compose(one.base_pose, forward(world.solver.chain, one.joint_positions))
        np.testing.assert_allclose(one.ee_pose, expected, atol=1e-9)


@TASKS
def test_goals_and_waypoints_are_those_of_the_world(robot, solver, task):
    """Desired poses do not depend on the base; a sub-goal ends where the achieved EE arrives."""
    world = World(robot, task, WorldConfig(max_failures=10**6), seed=5)
    world.start([0, 1])
    goals = draw_goals(solver, task, 2, 5)
    assert goals.shape == (2, len(task.subgoals), 7)
    np.testing.assert_array_equal(goals[:, 0], world.loop.goal)
    found, seen = draw_waypoints(solver, task, 2, 5)[:, :A_SUBGOAL], []
    for _ in range(1500):
        world.step(np.zeros((2, world.action_size)))
        seen.append(world.loop.desired)
    for row in range(2):
        missed = found[row][:, np.newaxis] - np.array(seen)[:, row]
        assert np.all(np.abs(missed).max(axis=2).min(axis=1) == 0.0)
