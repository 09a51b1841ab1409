import numpy as np
import pytest

from kinfeas.core.spatial import compose, rotation, yaw
from kinfeas.envs.world import World, evaluation_world
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.kinematics.solids import collides
from kinfeas.tasks.ggr import ggr, ggr_restricted
from kinfeas.tasks.obstacles import ggr_dynamic, ggr_obstacles
from kinfeas.tasks.task import MotionSpec, Subgoal


@pytest.mark.parametrize("task", [ggr(), ggr_restricted()], ids=lambda task: task.name)
def test_starts_and_goals_are_uniform_in_their_ranges(hsr, sample, uniform, task):
    reach = hsr.robot.reach
    low, high = reach.comfortable if task.restrict_start else (reach.low, reach.high)
    starts = sample(task)
    np.testing.assert_array_equal(starts.base_pose[:, :3], 0.0)
    assert uniform(yaw(starts.base_pose), -np.pi, np.pi)
    x, y, z = starts.target_poses[:, 0, :3].T
    assert uniform(np.hypot(x, y), 1.0, 5.0)
    assert uniform(np.arctan2(y, x), -np.pi, np.pi)
    assert uniform(z, low, high)
    assert not self_collides(hsr.collision, starts.joint_positions).any()
    ee = forward(hsr.chain, starts.joint_positions)
    tip = np.broadcast_to([*hsr.robot.tool_tip, 0.0, 0.0, 0.0, 1.0], ee.shape)
    assert compose(ee, tip)[:, 2].min() > 0.0
    height = ee[:, 2]
    assert ((height >= low) & (height <= high)).all() == (task.name == "ggr_restricted")
    again = task.sample(hsr, np.random.default_rng((0, 7)))
    for key in ("base_pose", "joint_positions", "target_poses"):
        np.testing.assert_array_equal(getattr(again, key), getattr(starts, key)[7])


def test_any_start_is_free_or_at_the_goal_heights(hsr, sample):
    low, high = hsr.robot.reach.comfortable
    free, starts = (sample(ggr_restricted(start=start)) for start in ("free", "any"))
    np.testing.assert_array_equal(starts.target_poses, free.target_poses)
    touching = self_collides(hsr.collision, starts.joint_positions)
    height = forward(hsr.chain, starts.joint_positions)[:, 2]
    outside = (height < low) | (height > high)
    assert touching.any()
    assert outside.any()
    assert not (touching & outside).any()


def test_orientations_are_uniform_in_rpy(sample, uniform):
    matrix = rotation(sample(ggr()).target_poses[:, 0]).as_matrix()
    sine = -matrix[:, 2, 0]  # of the pitch
    assert uniform(np.arcsin(sine), -np.pi / 2, np.pi / 2)
    assert not uniform(sine, -1.0, 1.0)


def test_parameters(sample):
    task = ggr(distance=[0.5, 0.6], heights=[1.3, 1.4], motion={"generator": "minimum_jerk"})
    assert task.subgoals == (Subgoal(MotionSpec("minimum_jerk")),)
    goal = sample(task, 50).target_poses[:, 0]
    reach = np.hypot(goal[:, 0], goal[:, 1])
    assert np.all((reach >= 0.5) & (reach <= 0.6))
    assert np.all((goal[:, 2] >= 1.3) & (goal[:, 2] <= 1.4))


TASKS = pytest.mark.parametrize("task", [ggr_obstacles(), ggr_dynamic()], ids=lambda one: one.name)


@TASKS
def test_starts_and_goals_are_free_of_solids(hsr, sample, task):
    starts = sample(task, 100)
    solids, (low, high) = starts.solids, (hsr.robot.reach.low, hsr.robot.reach.high)
    assert solids.pose.shape == (100, task.places, 3)
    goal = starts.target_poses[:, 0, :3]
    assert np.all((goal[:, 2] >= low) & (goal[:, 2] <= high))
    assert np.hypot(goal[:, 0], goal[:, 1]).max() > 6.0
    assert not collides(hsr.collision, starts.joint_positions, starts.base_pose, solids).any()
    ee = compose(starts.base_pose, forward(hsr.chain, starts.joint_positions))[:, :3]
    for point in (starts.base_pose[:, :3], ee):
        assert solids.gaps(point[:, np.newaxis])[0].min() >= 0.7
    for seconds in np.linspace(0.0, 60.0, 7):
        gaps = np.hypot(*solids.at(np.full(100, seconds)).gaps(goal[:, np.newaxis]))[:, 0]
        assert gaps.min() >= (0.25 if seconds == 0.0 else 0.1)  # seen at moments


def test_standing_solids_fill_the_room_and_a_third_is_high(sample):
    solids = sample(ggr_obstacles(), 50).solids
    full, height = solids.size[:, :, 0] > 0.0, solids.size[:, :, 3]
    assert full.sum(axis=1).min() > 50
    assert 2.0 * solids.size[full].max(axis=0)[0] <= 1.5
    for low, high, share in ((2.0, 2.0, 1 / 3), (0.05, 0.35, 1 / 3), (0.5, 0.9, 1 / 3)):
        of_kind = (height[full] >= low) & (height[full] <= high)
        assert abs(of_kind.mean() - share) < 0.05
    assert 0.1 < solids.cylinder[full].mean() < 0.3
    assert not solids.velocity.any()


def test_a_share_of_the_rooms_is_empty_and_motions_there_are_straight(hsr, sample):
    starts = sample(ggr_obstacles(empty=0.3), 200)
    empty = ~starts.solids.filled.any(axis=1)
    assert 0.2 < empty.mean() < 0.4
    world = World(hsr.robot, ggr_obstacles(empty=0.5), evaluation_world(), 0)
    world.start(range(12))
    planned = np.isfinite(world.loop.sequence.planned.base_pose[:, 0])
    empty = ~world.loop.surroundings.after(0.0).filled.any(axis=1)
    assert 2 < empty.sum() < 10
    assert not planned[empty].any()
    assert planned[~empty].mean() > 0.5
