from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import rotation, yaw
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.tasks.ggr import GoalReaching
from kinfeas.tasks.task import MotionSpec, Subgoal


def build(name, **parameters):
    return registry.build("kinfeas.tasks", name, parameters)


def sample(task, solver, n=400):
    """Return n episodes, stacked."""
    episodes = [task.sample(solver, np.random.default_rng((0, i))) for i in range(n)]
    return Start(*(np.array([vars(one)[key] for one in episodes]) for key in vars(episodes[0])))


def uniform(values, low, high):
    """Return whether values look uniform; a share of 1e-4 of good draws would not."""
    return kstest(values, "uniform", args=(low, high - low)).pvalue > 1e-4


@pytest.mark.parametrize("name", ["ggr", "ggr_restricted"])
def test_starts_and_goals(solver, name):
    low, high = solver.robot.goal_heights[name]
    task = build(name)
    assert task.name == name
    found = sample(task, solver)
    np.testing.assert_array_equal(found.base_pose[:, :3], 0.0)
    assert uniform(yaw(found.base_pose), -np.pi, np.pi)
    x, y, z = found.target_poses[:, 0, :3].T
    assert uniform(np.hypot(x, y), 1.0, 5.0)
    assert uniform(np.arctan2(y, x), -np.pi, np.pi)
    assert uniform(z, low, high)
    assert not self_collides(solver.collision, found.joint_positions).any()
    height = forward(solver.chain, found.joint_positions)[:, 2]
    within = (height >= low) & (height <= high)
    assert within.all() == (name == "ggr_restricted")


def test_any_start_is_free_or_at_the_goal_heights(exact_solver):
    low, high = exact_solver.robot.goal_heights["ggr_restricted"]
    free, found = (sample(build("ggr_restricted", start=s), exact_solver) for s in ("free", "any"))
    np.testing.assert_array_equal(found.target_poses, free.target_poses)
    touching = self_collides(exact_solver.collision, found.joint_positions)
    height = forward(exact_solver.chain, found.joint_positions)[:, 2]
    outside = (height < low) | (height > high)
    assert touching.any()
    assert outside.any()
    assert not (touching & outside).any()


def test_roll_pitch_and_yaw_are_uniform(exact_solver):
    """Then the height of the approach axis follows the arcsine law, not the uniform one."""
    quaternion = sample(build("ggr"), exact_solver).target_poses[:, 0, 3:]
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-12)
    assert quaternion[:, 3].min() >= 0.0
    lift = -Rotation.from_quat(quaternion).as_matrix()[:, 2, 0]  # sine of the pitch
    assert uniform(np.arcsin(lift), -np.pi / 2, np.pi / 2)
    assert not uniform(lift, -1.0, 1.0)


def test_so3_draws_uniform_rotations(exact_solver):
    revolute = rotation(
        sample(build("ggr", orientation="so3"), exact_solver).target_poses[:, 0]
    ).as_matrix()
    for i in range(3):
        for k in range(3):
            assert uniform(revolute[:, i, k], -1.0, 1.0)


def test_parameters(exact_solver):
    task = build("ggr", distance=(0.5, 0.6), heights=(1.3, 1.4))
    goal = sample(task, exact_solver, 50).target_poses[:, 0]
    reach = np.hypot(goal[:, 0], goal[:, 1])
    assert np.all((reach >= 0.5) & (reach <= 0.6))
    assert np.all((goal[:, 2] >= 1.3) & (goal[:, 2] <= 1.4))


def test_parameters_as_yaml_gives_them(exact_solver):
    task = build("ggr", distance=[1, 2], motion={"generator": "linear"})
    assert task.subgoals == (Subgoal(MotionSpec("linear")),)
    task.sample(exact_solver, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"distanse": (1, 2)}, "distanse"),
        ({"distance": (1,)}, "distance"),
        ({"distance": (2, 1)}, "distance"),
        ({"distance": (-1, 1)}, "distance"),
        ({"heights": "high"}, "heights"),
        ({"heights": (2, 1)}, "heights"),
        ({"orientation": "rpm"}, "orientation"),
        ({"motion": "linear"}, "motion"),
        ({"restrict_start": 3}, "restrict_start"),
        ({"start": "all"}, "start"),
    ],
)
@pytest.mark.parametrize("name", ["ggr", "ggr_restricted"])
def test_wrong_parameters_are_one_sentence(name, parameters, message):
    with pytest.raises(KinfeasError, match=message) as caught:
        build(name, **parameters)
    assert "\n" not in str(caught.value)


def test_a_robot_without_heights_for_the_task_is_one_sentence(exact_solver):
    task = replace(GoalReaching(), name="stacking")
    with pytest.raises(KinfeasError, match="has no goal heights for task 'stacking'; its YAML has"):
        task.sample(exact_solver, np.random.default_rng(0))


@pytest.mark.parametrize("name", ["ggr", "ggr_restricted"])
def test_same_seed_same_episode(solver, name):
    one, two = (build(name).sample(solver, np.random.default_rng(5)) for _ in range(2))
    other = build(name).sample(solver, np.random.default_rng(6))
    for key, value in vars(one).items():
        np.testing.assert_array_equal(value, vars(two)[key])
        assert not np.array_equal(value, vars(other)[key])
