import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.goal_task import begin, make_goal_task
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import MotionSpec


@pytest.mark.parametrize("base", [spatial.IDENTITY, spatial.planar_pose(3.0, 1.0, 2.0)])
def test_begins_where_the_robot_is_with_its_orientation_as_the_goal(base):
    solver = IkSolver(load_robot("hsr"))
    joints = solver.robot.home["home"][np.newaxis]
    real = None if base is spatial.IDENTITY else RobotState(base[np.newaxis], joints)
    task = make_goal_task((1.0, 2.0, 0.5), None, MotionSpec())
    start = begin(task, solver, np.random.default_rng(1), real)
    ee = spatial.compose(base[np.newaxis], forward(solver.chain, joints))
    np.testing.assert_array_equal(start.base_pose, [base])
    np.testing.assert_array_equal(start.joint_positions, joints)
    np.testing.assert_allclose(start.target_poses[0, 0], [1.0, 2.0, 0.5, *ee[0, 3:]], atol=1e-12)


def test_an_orientation_is_given_by_angles_or_a_quaternion():
    half = np.sqrt(0.5)
    for turn in ((0.0, 0.0, np.pi / 2.0), (0.0, 0.0, half, half)):
        task = make_goal_task((0.0, 0.0, 1.0), turn, MotionSpec())
        np.testing.assert_allclose(task.orientation, [0.0, 0.0, half, half], atol=1e-12)


@pytest.mark.parametrize(("position", "turn"), [
    ((np.nan, 0.0, 0.0), None),
    ((0.0, 0.0, 0.0), (np.inf, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
])  # fmt: skip
def test_invalid_goals_are_errors(position, turn):
    with pytest.raises(KinfeasError, match="goal"):
        make_goal_task(position, turn, MotionSpec())


def test_a_real_robot_has_the_solids_of_the_task_around_it_already():
    robot, task = load_robot("hsr"), load_task("ggr_obstacles", {})
    real = RobotState(spatial.IDENTITY[np.newaxis], robot.home["home"][np.newaxis])
    for measured in (None, real):
        start = begin(task, IkSolver(robot), np.random.default_rng(0), measured)
        assert (start.solids is None) == (measured is not None)
