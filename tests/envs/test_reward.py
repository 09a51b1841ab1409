from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.loop import Outcome
from kinfeas.envs.reward import RewardConfig, reward
from kinfeas.robots.loading import load_robot
from kinfeas.robots.spec import PoseTolerance

PAPER = RewardConfig(failure="indicator", action_penalty=0.01, limit_penalty=0.0)


def step(feasible, metres=0.0, radians=0.0):
    feasible = np.atleast_1d(feasible)
    n = len(feasible)
    zero, no = np.zeros(n), np.zeros(n, dtype=bool)
    subgoal = np.zeros(n, dtype=np.intp)
    return Outcome(
        feasible, zero + metres, zero + radians, zero, zero, subgoal, zero, zero, no, no, zero + 1.0
    )


@pytest.fixture(scope="module")
def exact_robot():
    return replace(load_robot("tiago"), pose_tolerance=None)


def middle(robot, n=1):
    half = [0.0 if joint.continuous else (joint.lower + joint.upper) / 2.0 for joint in robot.arm]
    return np.tile(half, (n, 1))


def test_indicator_of_the_paper(exact_robot):
    action = np.array([[0.0, 0.0], [0.0, 0.0], [0.6, -0.8], [1.0, 1.0]])
    seen = step([True, False, True, False], metres=[0.0, 3.0, 0.0, np.inf])
    earned = reward(PAPER, exact_robot, seen, action, middle(exact_robot, 4))
    np.testing.assert_allclose(earned, [0.0, -1.0, -0.01, -1.02], atol=1e-15)


def test_joint_jumps_and_deviations_cost(exact_robot):
    weights = RewardConfig("indicator", 0.0, 0.1, limit_penalty=0.0, deviation_penalty=0.4)
    seen = replace(
        step(np.ones(4, dtype=bool)),
        joint_jump=np.array([False, True, False, False]),
        deviation=np.array([0.0, 0.0, 0.025, 1.0]),
    )
    earned = reward(weights, exact_robot, seen, np.zeros((4, 2)), middle(exact_robot, 4))
    np.testing.assert_allclose(earned, [0.0, -0.1, -0.1, -0.4])


def test_graded_failure_grows_with_what_is_missing(exact_robot):
    graded = RewardConfig(failure="graded", action_penalty=0.0, limit_penalty=0.0)
    metres = np.array([0.0, 0.05, 0.1, 0.0, 0.1, 5.0, np.inf])
    radians = np.array([0.0, 0.0, 0.0, 0.15, 0.3, 0.0, np.inf])
    seen = step(np.zeros(7, dtype=bool), metres, radians)
    earned = reward(graded, exact_robot, seen, np.zeros((7, 2)), middle(exact_robot, 7))
    np.testing.assert_allclose(earned, [-0.2, -0.3, -0.6, -0.3, -1.0, -1.0, -1.0])
    seen = step(np.ones(7, dtype=bool), metres, radians)
    earned = reward(graded, exact_robot, seen, np.zeros((7, 2)), middle(exact_robot, 7))
    np.testing.assert_allclose(earned, 0.0, atol=1e-12)


def test_the_use_of_a_pose_tolerance_costs_on_feasible_steps_alone(exact_robot):
    lenient = replace(exact_robot, pose_tolerance=PoseTolerance(0.1, 0.2094))
    seen = step([True, True, True, False], [0.1, 0.0, 0.05, 0.3], [0.0, 0.2094, 0.1047, 0.3])
    earned = reward(PAPER, lenient, seen, np.zeros((4, 3)), middle(lenient, 4))
    np.testing.assert_allclose(earned, [-0.5, -0.5, -0.25, -1.0])


def test_limit_penalty_falls_from_the_limit_to_the_margin(exact_robot):
    weights = RewardConfig("indicator", 0.0, limit_penalty=0.1, limit_margin=0.2)
    bounded = next(i for i, joint in enumerate(exact_robot.arm) if not joint.continuous)
    joint = exact_robot.arm[bounded]
    half = (joint.upper - joint.lower) / 2.0
    joints = middle(exact_robot, 5)
    low, high = joint.lower, joint.upper
    joints[:, bounded] = [high, low, high - 0.1 * half, low + 0.2 * half, high - 0.5 * half]
    earned = reward(weights, exact_robot, step(np.ones(5, dtype=bool)), np.zeros((5, 2)), joints)
    np.testing.assert_allclose(earned, [-0.1, -0.1, -0.05, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("margin", [1e-9, 0.2])
def test_a_joint_beyond_its_limit_costs_as_one_at_it(exact_robot, margin):
    weights = RewardConfig("indicator", 0.0, limit_penalty=0.1, limit_margin=margin)
    bounded = next(i for i, joint in enumerate(exact_robot.arm) if not joint.continuous)
    joints = middle(exact_robot, 4)
    joints[:, bounded] = exact_robot.arm[bounded].upper + np.array([0.0, 1e-9, 0.01, 3.0])
    earned = reward(weights, exact_robot, step(np.ones(4, dtype=bool)), np.zeros((4, 2)), joints)
    np.testing.assert_allclose(earned, -0.1)


def test_continuous_joints_have_no_limit():
    robot = load_robot("pr2")
    weights = RewardConfig("indicator", 0.0, limit_penalty=0.1, limit_margin=1.0)
    joints = middle(robot)
    joints[:, robot.continuous] = 3.1
    earned = reward(weights, robot, step([True]), np.zeros((1, 2)), joints)
    np.testing.assert_allclose(earned, 0.0, atol=1e-12)


def test_collisions_cost(exact_robot):
    weights = RewardConfig("indicator", 0.0, limit_penalty=0.0)
    touched = np.array([[True, False], [False, True], [False, False]])
    seen = replace(step(np.ones(3, dtype=bool)), collision=touched)
    earned = reward(weights, exact_robot, seen, np.zeros((3, 2)), middle(exact_robot, 3))
    np.testing.assert_allclose(earned, [-10.0, -1.0, 0.0])


def test_the_distance_from_the_planned_base_costs(exact_robot):
    weights = RewardConfig("indicator", 0.0, limit_penalty=0.0, base_penalty=0.2)
    seen = step(np.ones(3, dtype=bool))
    given = np.zeros((3, 2)), middle(exact_robot, 3)
    np.testing.assert_array_equal(reward(weights, exact_robot, seen, *given), 0.0)
    earned = reward(weights, exact_robot, seen, *given, base_error=np.array([0.0, 0.25, 3.0]))
    np.testing.assert_allclose(earned, [0.0, -0.05, -0.2])
