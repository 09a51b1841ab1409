from dataclasses import replace

import numpy as np
import pytest

from kinfeas.control.loop import Outcome
from kinfeas.envs.reward import RewardConfig, reward
from kinfeas.robots.loading import load_robot
from kinfeas.robots.spec import PoseTolerance

NOTHING = RewardConfig(failure="indicator", action_penalty=0.0, limit_penalty=0.0)
TIAGO = load_robot("tiago")


def step(feasible, metres=0.0, radians=0.0, **changes):
    feasible = np.array(feasible)
    n = len(feasible)
    zero, no = np.zeros(n), np.zeros(n, dtype=bool)
    subgoal = np.zeros(n, dtype=np.intp)
    outcome = Outcome(
        feasible, zero + metres, zero + radians, zero, zero, subgoal, zero, zero, no, no, zero + 1.0
    )
    return replace(outcome, **{name: np.array(values) for name, values in changes.items()})


def middle(robot, n=1):
    half = [0.0 if joint.continuous else (joint.lower + joint.upper) / 2.0 for joint in robot.arm]
    return np.tile(half, (n, 1))


def earned(config, robot, outcome, action=None, joints=None, tolerance=None, **options):
    """Return the rewards of a step, by default of bases at rest and joints in their middles."""
    n, robot = len(outcome.feasible), replace(robot, pose_tolerance=tolerance)
    action = np.zeros((n, 2)) if action is None else action
    joints = middle(robot, n) if joints is None else joints
    return reward(config, robot, outcome, action, joints, **options)


FREE, FAILED = [True] * 4, [False] * 7
MISSING = [0.0, 0.05, 0.1, 0.0, 0.1, 5.0, np.inf], [0.0, 0.0, 0.0, 0.15, 0.3, 0.0, np.inf]
LENIENT = PoseTolerance(0.1, 0.2094)
USED = step([True, True, True, False], [0.1, 0.0, 0.05, 0.3], [0.0, 0.2094, 0.1047, 0.3])
JUMPS, DEVIATION = [False, True, False, False], [0.0, 0.0, 0.025, 1.0]
COLLISION = [[True, False], [False, True], [False, False], [True, True]]
ACTION = np.array([[0.0, 0.0], [0.0, 0.0], [0.6, -0.8], [1.0, 1.0]])


@pytest.mark.parametrize(("changes", "outcome", "options", "rewards"), [
    ({"action_penalty": 0.01}, step([True, False, True, False], [0.0, 3.0, 0.0, np.inf]),
     {"action": ACTION}, [0.0, -1.0, -0.01, -1.02]),
    ({"jump_penalty": 0.1, "deviation_penalty": 0.4},
     step(FREE, joint_jump=JUMPS, deviation=DEVIATION), {}, [0.0, -0.1, -0.1, -0.4]),
    # Graded failures grow with what is missing.
    ({"failure": "graded"}, step(FAILED, *MISSING), {}, [-0.2, -0.3, -0.6, -0.3, *[-1.0] * 3]),
    ({"failure": "graded"}, step([True] * 7, *MISSING), {}, [0.0] * 7),
    # The use of a pose tolerance costs on feasible steps alone.
    ({}, USED, {"tolerance": LENIENT}, [-0.5, -0.5, -0.25, -1.0]),
    ({}, step(FREE, collision=COLLISION), {}, [-10.0, -1.0, 0.0, -11.0]),
    ({"base_penalty": 0.2}, step(FREE[:3]), {}, [0.0] * 3),
    ({"base_penalty": 0.2}, step(FREE[:3]), {"base_error": np.array([0.0, 0.25, 3.0])},
     [0.0, -0.05, -0.2]),
])  # fmt: skip
def test_costs_of_a_step(changes, outcome, options, rewards):
    found = earned(replace(NOTHING, **changes), TIAGO, outcome, **options)
    np.testing.assert_allclose(found, rewards, atol=1e-12)


@pytest.mark.parametrize(("margin", "places", "rewards"), [
    (0.2, [1.0, -1.0, 0.9, -0.8, 0.5], [-0.1, -0.1, -0.05, 0.0, 0.0]),
    (1e-9, [1.0, 1.0 + 1e-9, 1.01, 4.0], [-0.1] * 4),
    (0.2, [1.0, 1.0 + 1e-9, 1.01, 4.0], [-0.1] * 4),
])  # fmt: skip
def test_limit_penalty_falls_from_the_limit_to_the_margin(margin, places, rewards):
    """With a joint at places of its range, -1 at its lower limit, 1 at its upper."""
    config = replace(NOTHING, limit_penalty=0.1, limit_margin=margin)
    bounded = next(i for i, joint in enumerate(TIAGO.arm) if not joint.continuous)
    joint, joints = TIAGO.arm[bounded], middle(TIAGO, len(places))
    joints[:, bounded] += np.array(places) * (joint.upper - joint.lower) / 2.0
    found = earned(config, TIAGO, step([True] * len(places)), joints=joints)
    np.testing.assert_allclose(found, rewards, atol=1e-12)


def test_continuous_joints_have_no_limit(pr2):
    joints = middle(pr2)
    joints[:, pr2.continuous] = 3.1
    config = replace(NOTHING, limit_penalty=0.1, limit_margin=1.0)
    np.testing.assert_allclose(earned(config, pr2, step([True]), joints=joints), 0.0, atol=1e-12)
