import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task

FILTERS = (PluginSpec("base_path"), PluginSpec("feasibility"))


def world_of(robot="hsr", task="ggr_obstacles", filters=FILTERS, **parameters):
    config = WorldConfig(max_failures=9, filters=filters)
    return World(load_robot(robot), load_task(task, parameters), config, seed=3)


def test_more_goals_among_solids_are_reached_and_rows_are_independent():
    robot = load_robot("hsr")
    policy = load_policy("follow_ee", robot)
    near = {"distance": (1.0, 3.0)}
    alone = run_episodes(world_of(filters=FILTERS[1:], **near), policy, 5)
    planned = run_episodes(world_of(**near), policy, 5)
    assert planned.success.sum() >= alone.success.sum() + 2
    some = run_episodes(world_of(**near), policy, 1, first=3)
    np.testing.assert_array_equal(some.steps, planned.steps[3:4])
    np.testing.assert_array_equal(some.mean_deviation, planned.mean_deviation[3:4])


def test_the_policy_drives_among_moving_solids():
    world = world_of(task="ggr_dynamic", filters=FILTERS[:1])
    world.start(range(3))
    command = np.full((3, 3), 0.25)
    (one,) = world.loop.filters
    np.testing.assert_array_equal(one(command, world.loop.policy_input), command)


@pytest.mark.parametrize(
    ("robot", "task", "needs"),
    [("tiago", "ggr", "omnidirectional"), ("hsr", "joystick", "EE motions with an end")],
)
def test_other_bases_and_endless_motions_are_errors(robot, task, needs):
    with pytest.raises(KinfeasError, match=needs):
        world_of(robot, task).start(range(1))
