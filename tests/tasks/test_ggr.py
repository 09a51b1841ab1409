import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation, yaw
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.tasks.ggr import ggr, ggr_restricted
from kinfeas.tasks.task import MotionSpec, Subgoal


@pytest.mark.parametrize("task", [ggr(), ggr_restricted()], ids=lambda task: task.name)
def test_starts_and_goals_are_uniform_in_their_ranges(hsr, sample, uniform, task):
    low, high = hsr.robot.goal_heights[task.name]
    found = sample(task)
    np.testing.assert_array_equal(found.base_pose[:, :3], 0.0)
    assert uniform(yaw(found.base_pose), -np.pi, np.pi)
    x, y, z = found.target_poses[:, 0, :3].T
    assert uniform(np.hypot(x, y), 1.0, 5.0)
    assert uniform(np.arctan2(y, x), -np.pi, np.pi)
    assert uniform(z, low, high)
    assert not self_collides(hsr.collision, found.joint_positions).any()
    height = forward(hsr.chain, found.joint_positions)[:, 2]
    assert ((height >= low) & (height <= high)).all() == (task.name == "ggr_restricted")
    again = task.sample(hsr, np.random.default_rng((0, 7)))
    for key in ("base_pose", "joint_positions", "target_poses"):
        np.testing.assert_array_equal(getattr(again, key), getattr(found, key)[7])


def test_any_start_is_free_or_at_the_goal_heights(hsr, sample):
    low, high = hsr.robot.goal_heights["ggr_restricted"]
    free, found = (sample(ggr_restricted(start=start)) for start in ("free", "any"))
    np.testing.assert_array_equal(found.target_poses, free.target_poses)
    touching = self_collides(hsr.collision, found.joint_positions)
    height = forward(hsr.chain, found.joint_positions)[:, 2]
    outside = (height < low) | (height > high)
    assert touching.any()
    assert outside.any()
    assert not (touching & outside).any()


def test_orientations_are_uniform_in_rpy_or_so3(sample, uniform):
    matrix = rotation(sample(ggr()).target_poses[:, 0]).as_matrix()
    sine = -matrix[:, 2, 0]  # of the pitch
    assert uniform(np.arcsin(sine), -np.pi / 2, np.pi / 2)
    assert not uniform(sine, -1.0, 1.0)
    matrix = rotation(sample(ggr(orientation="so3")).target_poses[:, 0]).as_matrix()
    assert all(uniform(matrix[:, i, k], -1.0, 1.0) for i in range(3) for k in range(3))


def test_parameters(hsr, sample):
    task = ggr(distance=[0.5, 0.6], heights=[1.3, 1.4], motion={"generator": "minimum_jerk"})
    assert task.subgoals == (Subgoal(MotionSpec("minimum_jerk")),)
    goal = sample(task, 50).target_poses[:, 0]
    reach = np.hypot(goal[:, 0], goal[:, 1])
    assert np.all((reach >= 0.5) & (reach <= 0.6))
    assert np.all((goal[:, 2] >= 1.3) & (goal[:, 2] <= 1.4))
    with pytest.raises(KinfeasError, match="'stacking'"):
        ggr(name="stacking").sample(hsr, np.random.default_rng(0))
