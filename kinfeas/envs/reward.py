"""The reward of a step: feasibility, and costs of actions, joint jumps and joint limits."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinfeas.control.loop import Outcome
from kinfeas.core.kernels import exact
from kinfeas.core.metrics import WITHIN
from kinfeas.core.quantities import NotNegative, PositiveFraction
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

_FAILURE_FLOOR, _FAILURE_SLOPE = 0.2, 0.4  # least cost, and increase for each squared unit error
_FAILURE_METRES, _FAILURE_RADIANS = 0.1, 0.3  # unit errors of IK
_BASE_METRES = 0.5  # distance from the planned base that costs the full penalty


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward."""

    # `indicator` costs 1 for each kinematic failure, as in the paper; `graded` costs between 0.2
    # and 1, growing with the square of the remaining error of IK
    failure: Literal["indicator", "graded"] = "graded"
    action_penalty: NotNegative = 0.001  # factor lambda on the squared norm of the action
    # cost of a step in which an arm joint has to move faster than it can
    jump_penalty: NotNegative = 0.1
    # cost of a joint at its limit, falling linearly to 0 at `limit_margin`
    limit_penalty: NotNegative = 0.02
    # distance to the nearest joint limit, as a fraction of half the joint's range
    limit_margin: PositiveFraction = 0.2
    # cost of a step with the EE 5 cm or more from its desired position; less, with the square of
    # the distance, where it is nearer
    deviation_penalty: NotNegative = 0.0
    # cost of a collision of the base with a solid, which ends the episode; those of the arm cost a
    # tenth
    collision_penalty: NotNegative = 10.0
    # cost of a step with the base 0.5 m or more from the planned base, which is ahead of it; less,
    # with the square of the distance, where it is nearer
    base_penalty: NotNegative = 0.0


def reward(
    config: RewardConfig,
    robot: Robot,
    outcome: Outcome,
    action: Array,
    joint_positions: Array,
    base_error: Array | None = None,
) -> Array:
    """Return the reward of a step, shape (n,).

    The action is in [-1, 1], shape (n, a), arm joints, shape (n, j), are those after the step, and
    `base_error` is the distance from the planned base, metres, shape (n,). With a pose tolerance,
    feasible steps cost half the squared ratios of position and rotation error to the tolerance.
    """
    lower, upper = robot.joint_limits
    tolerance = robot.pose_tolerance
    earned = np.empty(len(action))
    _earn(
        (
            config.failure == "indicator", config.action_penalty, config.jump_penalty,
            config.deviation_penalty, config.limit_penalty, config.limit_margin,
        ),
        (0.0, 0.0) if tolerance is None else (tolerance.position, tolerance.rotation),
        outcome.feasible, outcome.position_error, outcome.rotation_error, outcome.deviation,
        outcome.joint_jump,
        np.ascontiguousarray(action), np.ascontiguousarray(joint_positions), lower, upper, earned,
    )  # fmt: skip
    if outcome.collision is not None:
        earned -= config.collision_penalty * (outcome.collision @ np.array([1.0, 0.1]))
    if config.base_penalty and base_error is not None:
        earned -= config.base_penalty * np.minimum(base_error / _BASE_METRES, 1.0) ** 2
    return earned


@exact
def _earn(
    weights, tolerance, feasible, metres, radians, deviation, jumps, action, joints, lower, upper,
    earned,
):  # fmt: skip
    indicator, action_penalty, jump_penalty, deviation_penalty, limit_penalty, margin = weights
    for i in range(len(earned)):
        total = 0.0
        for k in range(action.shape[1]):
            total -= action_penalty * (action[i, k] * action[i, k])
        if not feasible[i]:
            missing = _squares(metres[i], radians[i], _FAILURE_METRES, _FAILURE_RADIANS)
            total -= 1.0 if indicator else min(1.0, _FAILURE_FLOOR + _FAILURE_SLOPE * missing)
        elif tolerance[0] > 0.0:
            total -= 0.5 * _squares(metres[i], radians[i], tolerance[0], tolerance[1])
        if jumps[i]:
            total -= jump_penalty
        if deviation_penalty > 0.0:
            fraction = min(deviation[i] / WITHIN, 1.0)
            total -= deviation_penalty * (fraction * fraction)
        if limit_penalty > 0.0 and margin > 0.0:
            # A joint that is measured beyond its limit costs no more than one at it.
            short = margin - _limit_distance(joints[i], lower, upper)
            total -= limit_penalty * (min(max(short, 0.0), margin) / margin)
        earned[i] = total


@exact
def _limit_distance(joints, lower, upper):
    """Return the distance to the nearest limit as a fraction of half the range; 1 without any."""
    distance = 1.0
    for j in range(len(joints)):
        if upper[j] < np.inf:
            inside = min(joints[j] - lower[j], upper[j] - joints[j])
            distance = min(distance, inside / ((upper[j] - lower[j]) / 2.0))
    return distance


@exact
def _squares(metres, radians, unit_metres, unit_radians):
    linear, angular = metres / unit_metres, radians / unit_radians
    return linear * linear + angular * angular
