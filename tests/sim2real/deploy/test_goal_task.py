import numpy as np
import pytest

from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.loading import load_robot
from kinfeas.sim2real.deploy.goal_task import begin, make_goal_task
from kinfeas.tasks.task import MotionSpec


@pytest.fixture(scope="module")
def pr2():
    return IkSolver(load_robot("pr2"))


def test_begins_at_the_origin_with_the_ee_turned_as_it_is(pr2):
    task = make_goal_task((1.0, 2.0, 0.5), None, MotionSpec())
    start = begin(task, pr2, np.random.default_rng(1), None)
    ee = forward(pr2.chain, start.joint_positions)
    np.testing.assert_array_equal(start.base_pose, [spatial.IDENTITY])
    np.testing.assert_allclose(start.target_poses[0, 0], [1.0, 2.0, 0.5, *ee[0, 3:]], atol=1e-12)


def test_begins_where_a_live_robot_stands(pr2):
    base = spatial.planar_pose(*np.array([[3.0], [1.0], [2.0]]))
    joints = pr2.robot.home["home"][np.newaxis]
    task = make_goal_task((1.0, 2.0, 0.5), None, MotionSpec())
    start = begin(task, pr2, np.random.default_rng(1), RobotState(base, joints))
    ee = spatial.compose(base, forward(pr2.chain, joints))
    np.testing.assert_array_equal(start.base_pose, base)
    np.testing.assert_array_equal(start.joint_positions, joints)
    np.testing.assert_allclose(start.target_poses[0, 0, 3:], ee[0, 3:], atol=1e-12)


def test_angles_and_quaternion_say_the_same():
    half = np.sqrt(0.5)
    for turn in ((0.0, 0.0, np.pi / 2.0), (0.0, 0.0, half, half)):
        task = make_goal_task((0.0, 0.0, 1.0), turn, MotionSpec())
        np.testing.assert_allclose(task.orientation, [0.0, 0.0, half, half], atol=1e-12)


@pytest.mark.parametrize(("position", "turn"), [
    ((np.nan, 0.0, 0.0), None),
    ((1e300, 0.0, 0.0), None),
    ((0.0, 0.0, 0.0), (np.inf, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
])  # fmt: skip
def test_refuses_what_is_no_goal(position, turn):
    with pytest.raises(KinfeasError, match="goal"):
        make_goal_task(position, turn, MotionSpec())
