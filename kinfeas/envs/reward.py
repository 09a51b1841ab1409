"""The reward of a step: feasibility, and costs of actions, joint jumps and joint limits."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinfeas.config.quantities import NotNegative, PositiveShare
from kinfeas.control.loop import Step
from kinfeas.core.metrics import WITHIN
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

_FAILURE_FLOOR, _FAILURE_SLOPE = 0.2, 0.4
_FAILURE_METRES, _FAILURE_RADIANS = 0.1, 0.3


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward.

    Attributes:
        failure: `indicator` costs 1 for each kinematic failure, as in the paper; `graded` costs
            between 0.2 and 1, growing with the distance that IK could not close.
        action_penalty: Factor lambda on the squared norm of the action.
        jump_penalty: Cost of a step in which an arm joint has to move faster than it can.
        limit_penalty: Cost of a joint at its limit, falling linearly to 0 at `limit_margin`.
        limit_margin: Distance to the nearest joint limit, as a share of half the joint's range.
        deviation_penalty: Cost of a step with the EE 5 cm or more from its desired position; less,
            with the square of the distance, where it is nearer.
    """

    failure: Literal["indicator", "graded"] = "graded"
    action_penalty: NotNegative = 0.001
    jump_penalty: NotNegative = 0.1
    limit_penalty: NotNegative = 0.02
    limit_margin: PositiveShare = 0.2
    deviation_penalty: NotNegative = 0.0


def reward(
    config: RewardConfig, robot: Robot, step: Step, action: Array, joint_positions: Array
) -> Array:
    """Return the reward of a step, shape (n,).

    Args:
        config: Weights.
        robot: Robot with its joint limits and pose tolerance.
        step: Result of the loop's step.
        action: Base commands in [-1, 1], shape (n, a).
        joint_positions: Arm joints after the step, shape (n, j).
    """
    earned = np.where(step.feasible, 0.0, -_failure_cost(config, step))
    earned -= config.action_penalty * np.sum(np.square(action), axis=1)
    earned -= config.jump_penalty * step.joint_jump
    if config.deviation_penalty > 0.0:
        share = np.minimum(step.deviation / WITHIN, 1.0)
        earned -= config.deviation_penalty * np.square(share)
    if config.limit_penalty > 0.0:
        short = config.limit_margin - limit_distance(robot, joint_positions)
        # A joint that is measured beyond its limit costs no more than one at it.
        short = np.clip(short, 0.0, config.limit_margin)
        earned -= config.limit_penalty * short / max(config.limit_margin, 1e-9)
    if robot.pose_tolerance is not None:
        approximation = np.square(step.position_error / robot.pose_tolerance.position) + np.square(
            step.rotation_error / robot.pose_tolerance.rotation
        )
        earned -= np.where(step.feasible, 0.5 * approximation, 0.0)
    return earned


def limit_distance(robot: Robot, joint_positions: Array) -> Array:
    """Return the distance to the nearest joint limit as a share of half the range, shape (n,).

    Continuous joints have no limit; without any other joint the distance is 1.
    """
    bounded = ~robot.continuous
    if not bounded.any():
        return np.ones(len(joint_positions))
    lower, upper = (limit[bounded] for limit in robot.joint_limits)
    positions = joint_positions[:, bounded]
    inside = np.minimum(positions - lower, upper - positions)
    distance: Array = np.min(inside / ((upper - lower) / 2.0), axis=1)
    return distance


def _failure_cost(config: RewardConfig, step: Step) -> Array:
    if config.failure == "indicator":
        return np.ones(len(step.feasible))
    missing = np.square(step.position_error / _FAILURE_METRES)
    missing += np.square(step.rotation_error / _FAILURE_RADIANS)
    return np.minimum(1.0, _FAILURE_FLOOR + _FAILURE_SLOPE * missing)
