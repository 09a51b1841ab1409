from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.loop import Outcome
from kinfeas.envs.reward import RewardConfig, reward
from kinfeas.robots.loading import load_robot
from kinfeas.robots.spec import PoseTolerance

PAPER = RewardConfig(failure="indicator", action_penalty=0.01, limit_penalty=0.0)
NOTHING = replace(PAPER, action_penalty=0.0)


def step(feasible, metres=0.0, radians=0.0, **changes):
    feasible = np.atleast_1d(feasible)
    n = len(feasible)
    zero, no = np.zeros(n), np.zeros(n, dtype=bool)
    subgoal = np.zeros(n, dtype=np.intp)
    outcome = Outcome(
        feasible, zero + metres, zero + radians, zero, zero, subgoal, zero, zero, no, no, zero + 1.0
    )
    return replace(outcome, **{name: np.array(values) for name, values in changes.items()})


@pytest.fixture(scope="module")
def exact_robot():
    return replace(load_robot("tiago"), pose_tolerance=None)


def middle(robot, n=1):
    half = [0.0 if joint.continuous else (joint.lower + joint.upper) / 2.0 for joint in robot.arm]
    return np.tile(half, (n, 1))


def earned(config, robot, outcome, action=None, joints=None, **options):
    """Return the rewards of a step, by default of bases at rest and joints in their middles."""
    n = len(outcome.feasible)
    action = np.zeros((n, 2)) if action is None else np.array(action)
    joints = middle(robot, n) if joints is None else joints
    return reward(config, robot, outcome, action, joints, **options)


def test_indicator_of_the_paper(exact_robot):
    action = [[0.0, 0.0], [0.0, 0.0], [0.6, -0.8], [1.0, 1.0]]
    outcome = step([True, False, True, False], metres=[0.0, 3.0, 0.0, np.inf])
    rewards = earned(PAPER, exact_robot, outcome, action)
    np.testing.assert_allclose(rewards, [0.0, -1.0, -0.01, -1.02], atol=1e-15)


def test_joint_jumps_and_deviations_cost(exact_robot):
    config = replace(NOTHING, jump_penalty=0.1, deviation_penalty=0.4)
    jumps, deviation = [False, True, False, False], [0.0, 0.0, 0.025, 1.0]
    outcome = step([True] * 4, joint_jump=jumps, deviation=deviation)
    np.testing.assert_allclose(earned(config, exact_robot, outcome), [0.0, -0.1, -0.1, -0.4])


def test_graded_failure_grows_with_what_is_missing(exact_robot):
    graded = replace(NOTHING, failure="graded")
    missing = [0.0, 0.05, 0.1, 0.0, 0.1, 5.0, np.inf], [0.0, 0.0, 0.0, 0.15, 0.3, 0.0, np.inf]
    rewards = earned(graded, exact_robot, step([False] * 7, *missing))
    np.testing.assert_allclose(rewards, [-0.2, -0.3, -0.6, -0.3, -1.0, -1.0, -1.0])
    rewards = earned(graded, exact_robot, step([True] * 7, *missing))
    np.testing.assert_allclose(rewards, 0.0, atol=1e-12)


def test_the_use_of_a_pose_tolerance_costs_on_feasible_steps_alone(exact_robot):
    lenient = replace(exact_robot, pose_tolerance=PoseTolerance(0.1, 0.2094))
    outcome = step([True, True, True, False], [0.1, 0.0, 0.05, 0.3], [0.0, 0.2094, 0.1047, 0.3])
    np.testing.assert_allclose(earned(PAPER, lenient, outcome), [-0.5, -0.5, -0.25, -1.0])


def near_a_limit(robot, config, places):
    """Return rewards with a joint at places of its range, -1 at its lower limit, 1 at its upper."""
    bounded = next(i for i, joint in enumerate(robot.arm) if not joint.continuous)
    joint, joints = robot.arm[bounded], middle(robot, len(places))
    joints[:, bounded] += np.array(places) * (joint.upper - joint.lower) / 2.0
    return earned(config, robot, step([True] * len(places)), joints=joints)


def test_limit_penalty_falls_from_the_limit_to_the_margin(exact_robot):
    config = replace(NOTHING, limit_penalty=0.1, limit_margin=0.2)
    rewards = near_a_limit(exact_robot, config, [1.0, -1.0, 0.9, -0.8, 0.5])
    np.testing.assert_allclose(rewards, [-0.1, -0.1, -0.05, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("margin", [1e-9, 0.2])
def test_a_joint_beyond_its_limit_costs_as_one_at_it(exact_robot, margin):
    config = replace(NOTHING, limit_penalty=0.1, limit_margin=margin)
    rewards = near_a_limit(exact_robot, config, [1.0, 1.0 + 1e-9, 1.01, 4.0])
    np.testing.assert_allclose(rewards, -0.1)


def test_continuous_joints_have_no_limit(pr2):
    joints = middle(pr2)
    joints[:, pr2.continuous] = 3.1
    config = replace(NOTHING, limit_penalty=0.1, limit_margin=1.0)
    np.testing.assert_allclose(earned(config, pr2, step([True]), joints=joints), 0.0, atol=1e-12)


def test_collisions_cost(exact_robot):
    outcome = step([True] * 3, collision=[[True, False], [False, True], [False, False]])
    np.testing.assert_allclose(earned(NOTHING, exact_robot, outcome), [-10.0, -1.0, 0.0])


def test_the_distance_from_the_planned_base_costs(exact_robot):
    config, outcome = replace(NOTHING, base_penalty=0.2), step([True] * 3)
    np.testing.assert_array_equal(earned(config, exact_robot, outcome), 0.0)
    rewards = earned(config, exact_robot, outcome, base_error=np.array([0.0, 0.25, 3.0]))
    np.testing.assert_allclose(rewards, [0.0, -0.05, -0.2])
