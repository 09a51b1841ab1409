import numpy as np
import pytest

from kinfeas import registry
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.ceiling import draw_goals, measure_ceiling
from kinfeas.kinematics.ik import IkOptions
from kinfeas.tasks.ggr import ggr


def test_goals_are_those_of_the_world(robot, solver):
    task = ggr()
    world = World(robot, task, WorldConfig(), seed=5)
    world.start(range(6))
    np.testing.assert_allclose(draw_goals(solver, task, 6, 5), world.loop.goal, atol=1e-12)


def test_ceilings_are_as_the_method_says(robot):
    share = measure_ceiling(robot, ggr(), 150, 1).share
    least, most = {"pr2": (0.95, 1.0), "tiago": (0.86, 0.98), "hsr": (0.9, 1.0)}[robot.name]
    assert least <= share.value <= most
    assert share.low < share.value < share.high or share.value == 1.0


def test_pr2_cannot_reach_as_high_as_the_table_of_the_paper():
    robot = registry.load_robot("pr2")
    high = ggr(heights=(1.2, 1.4))
    assert measure_ceiling(robot, high, 60, 1).share.value < 0.5


def test_leeway_ends_at_the_goal():
    robot = registry.load_robot("hsr")
    task = ggr(heights=(0.05, 1.7))
    strict = measure_ceiling(robot, task, 100, 1).reached
    exact = measure_ceiling(robot, task, 100, 1, IkOptions(leeway=False)).reached
    assert exact.sum() < strict.sum() < 100
    assert not np.any(exact & ~strict)


@pytest.mark.parametrize("robot_name", ["tiago"])
def test_self_collision_lowers_it(robot_name):
    robot = registry.load_robot(robot_name)
    free = measure_ceiling(robot, ggr(), 120, 3, IkOptions(self_collision=False)).share
    assert measure_ceiling(robot, ggr(), 120, 3).share.value <= free.value
