import numpy as np
import pytest

from kinfeas.backends.analytic import AnalyticBackend
from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.loop import Loop
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.reachability import reachable
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.goal_task import begin, make_goal_task
from kinfeas.sim2real.deploy.preflight import preflight
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import MotionSpec, build_subgoals

HSR = IkSolver(load_robot("hsr"))


def goal(*position, rpy=None):
    return make_goal_task(position, rpy, MotionSpec())


def checked(task, guards, execution=None, solver=HSR):
    """Return the warning about a task."""
    rng = np.random.default_rng(3)
    loop = Loop(solver, build_subgoals(task.subgoals), AnalyticBackend(), 0.02, execution)
    return preflight(loop, begin(task, solver, rng, None), rng, guards)


@pytest.mark.parametrize(
    "task", ["door", "drawer", "pick_place", (0.9, 0.1, 0.8), (-3.0, 2.0, 0.6)]
)
def test_reachable_goals_pass(task):
    task = load_task(task, {}) if isinstance(task, str) else goal(*task)
    assert checked(task, Guards()) == ""


@pytest.mark.parametrize("height", [-0.5, 2.2, 90.0])
def test_a_goal_out_of_reach_is_an_error_with_its_pose(height):
    task = goal(1.5, 0.0, height, rpy=(0.0, 0.1, -0.2))
    with pytest.raises(
        KinfeasError, match=rf"x 1.5, y 0, z {height:g} m, roll 0, pitch 0.1, yaw -0.2 rad"
    ):
        checked(task, Guards())
    assert checked(task, Guards(reach=False)) == ""


def test_the_tolerance_is_that_of_a_reached_goal():
    pr2, high = IkSolver(load_robot("pr2")), (1.5, 0.0, 1.28)
    pose = np.array([[*high, 0.0, 0.0, 0.0, 1.0]])
    assert not reachable(pr2, pose).reached.any()
    assert checked(goal(*high), Guards(), solver=pr2) == ""


@pytest.mark.parametrize(
    ("speed", "time_scale", "factor"),
    [(None, 1.0, None), (0.2, 1.0, None), (0.1, 0.5, None), (0.09, 1.0, 0.45), (0.05, 0.6, 0.25)],
)
def test_warns_of_a_base_that_is_slower_than_the_ee(speed, time_scale, factor):
    guards, far = Guards(max_linear_velocity=speed), goal(4.0, 0.0, 0.8)
    warning = checked(far, guards, ExecutionConfig(time_scale=time_scale))
    assert bool(warning) is (factor is not None)
    assert factor is None or f"time_scale={factor}" in warning
