import numpy as np
import pytest

from kinfeas.control.execution import tool_pose
from kinfeas.core import spatial
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.waypoints import A_SUBGOAL, draw_goals, draw_waypoints
from kinfeas.tasks.chain import pick_place
from kinfeas.tasks.ggr import ggr


@pytest.mark.parametrize("task", [ggr(), pick_place()], ids=lambda task: task.name)
def test_goals_are_those_of_the_world(robot, solver, task):
    world = World(robot, task, WorldConfig(), seed=5)
    world.start(range(6))
    goals = draw_goals(solver, task, 6, 5)
    assert goals.shape == (6, len(task.subgoals), 7)
    np.testing.assert_array_equal(goals[:, 0], world.loop.goal)


def test_tips_come_to_the_targets(robot, solver):
    task = pick_place()
    goals = draw_goals(solver, task, 4, 0)
    tips = spatial.compose(goals, np.broadcast_to(tool_pose(robot), goals.shape))
    starts = [task.sample(solver, np.random.default_rng((0, episode))) for episode in range(4)]
    targets = np.stack([start.target_poses for start in starts])
    np.testing.assert_allclose(np.stack(spatial.distance(tips, targets)), 0.0, atol=1e-6)


@pytest.mark.parametrize("task", [ggr(), pick_place()], ids=lambda task: task.name)
def test_waypoints_are_on_the_way_of_the_world(robot, solver, task):
    """Desired poses do not depend on the base; a sub-goal ends where the achieved EE arrives."""
    world = World(robot, task, WorldConfig(max_failures=10**6), seed=5)
    world.start([0, 1])
    found = draw_waypoints(solver, task, 2, 5)[:, :A_SUBGOAL]
    seen = []
    for _ in range(1500):
        world.step(np.zeros((2, world.action_size)))
        seen.append(world.loop.desired)
    for row in range(2):
        missed = found[row][:, np.newaxis] - np.array(seen)[:, row]
        assert np.all(np.abs(missed).max(axis=2).min(axis=1) == 0.0)


def test_waypoints_end_at_the_legs_ends(solver):
    task = pick_place()
    goals = draw_goals(solver, task, 5, 0)
    found = draw_waypoints(solver, task, 5, 0).reshape(5, 4, A_SUBGOAL, 7)
    metres, radians = spatial.distance(found[:, :, -1], goals)
    assert np.all((metres <= 0.025) & (radians <= np.deg2rad(12.0)))
    assert np.all(spatial.distance(found[:, :, -2], goals)[0] > metres)


def test_no_episode_depends_on_the_others(solver):
    several = draw_waypoints(solver, pick_place(), 4, 3)
    np.testing.assert_array_equal(draw_waypoints(solver, pick_place(), 2, 3), several[:2])
