import itertools

import numpy as np
import pytest

from kinfeas.config import PluginSpec
from kinfeas.control.base_path import BasePathPlanner
from kinfeas.control.drive import base_twist
from kinfeas.control.filters.path_planner import follow
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import integrate, planar_pose, yaw
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import World, WorldConfig
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task


def world_of(robot, task="ggr_restricted", filters=("path_planner", "feasibility")):
    config = WorldConfig(max_failures=99, filters=tuple(map(PluginSpec, filters)))
    return World(load_robot(robot), load_task(task, {}), config, seed=3)


@pytest.mark.parametrize("name", ["pr2", "tiago"])
def test_the_base_goes_where_the_policy_would_not(name):
    alone, ahead = (
        world_of(name, filters=given) for given in ((), ("path_planner", "feasibility"))
    )
    policy = load_policy("follow_ee", alone.robot)
    alone, ahead = (run_episodes(world, policy, 6) for world in (alone, ahead))
    assert ahead.success.sum() > alone.success.sum()
    assert ahead.joint_jumps.sum() < alone.joint_jumps.sum()
    assert ahead.success.sum() >= 5


def test_episodes_do_not_depend_on_each_other():
    policy = load_policy("stationary", load_robot("pr2"))
    together = run_episodes(world_of("pr2", "drawer"), policy, 2)
    alone = run_episodes(world_of("pr2", "drawer"), policy, 1, first=1)
    np.testing.assert_array_equal(together.max_deviation[1:], alone.max_deviation)
    assert alone.success.all()


def test_a_robot_that_is_pushed_gets_a_new_path(monkeypatch):
    world = world_of("pr2")
    loop, policy = world.loop, load_policy("stationary", world.robot)
    loop.set_policy(policy)
    world.start([0])
    planned, plan = [], BasePathPlanner.plan

    def noted(self, *args, **options):
        path = plan(self, *args, **options)
        planned.append(len(path.seconds))
        return path

    monkeypatch.setattr(BasePathPlanner, "plan", noted)
    done = False
    for period in range(1500):
        if period == 100:
            state = loop.snapshot()
            state["base_pose"] = integrate(
                state["base_pose"], np.array([[0.3, 0, 0, 0, 0, 0]]), 1.0
            )
            loop.restore(state)
        done = bool(world.step().reached[0])
        if done:
            break
    assert done
    assert len(planned) == 2
    assert planned[1] < planned[0]


def test_targets_that_are_not_known_in_advance_are_an_error():
    with pytest.raises(KinfeasError, match="path_planner"):
        world_of("pr2", "joystick")


@pytest.mark.parametrize("turning", [0.0, 0.2])
def test_a_base_beside_its_path_returns_to_it(robot, turning):
    base, dt = robot.base, 0.1
    path = np.zeros((600, 3))
    path[:, 2] = turning * dt * np.arange(600)
    speed = 0.5 * base.max_velocity * dt
    path[1:, 0] = np.cumsum(speed * np.cos(path[:-1, 2]))
    path[1:, 1] = np.cumsum(speed * np.sin(path[:-1, 2]))
    pose = planar_pose(np.array([0.05]), np.array([0.1]), np.array([0.3]))
    for now, then in itertools.pairwise(path):
        command = follow(base, pose, now[np.newaxis], then[np.newaxis], dt)
        assert np.abs(command).max() <= 1.0
        pose = integrate(pose, base_twist(base, pose, command, dt), dt)
    assert np.linalg.norm(pose[0, :2] - path[-1, :2]) < 0.01
    assert (
        abs(float(yaw(pose[0])) - np.arctan2(*np.sin([path[-1, 2], path[-1, 2] + np.pi / 2])))
        < 0.03
    )
