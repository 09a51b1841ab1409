"""The `servo` motion: follows a moving target within limits of velocity, acceleration and jerk."""

from dataclasses import dataclass

import numpy as np

from kinfeas.core.motion import Rngs, State, TwistAndState
from kinfeas.core.quantities import Positive, Seconds
from kinfeas.core.spatial import Array, integrate, twist_between
from kinfeas.plugins.path import slowed

_ACCELERATION = 2.0 / np.e
_JERK = 2.0 + 2.0 / np.e**2
"""L1 norms of the impulse responses from the command to acceleration and jerk, at a time constant
of one second: bounds of their size at a command of size one."""


@dataclass(eq=False, kw_only=True)
class Servo:
    """Follows a moving target smoothly, without overshoot.

    The velocity that would bring the EE to rest at the target is limited and passes two equal
    first-order low-pass filters, integrated exactly for any `dt`. Velocities are means of past
    commands, so they keep the velocity limit; the time constant is the smallest one that keeps the
    other two for any sequence of targets. Positions are means of past targets, so they stay within
    any convex region that contains these.

    Args:
        max_velocity: Limit of the linear velocity, m/s.
        max_angular_velocity: The same, rad/s.
        max_acceleration: Limit of the linear acceleration, m/s^2.
        max_angular_acceleration: The same, rad/s^2.
        max_jerk: Limit of the linear jerk, m/s^3.
        max_angular_jerk: The same, rad/s^3.
        lookahead: Seconds of motion at the current velocity to the goal that the policy observes.
    """

    max_velocity: Positive = 0.2
    max_angular_velocity: Positive = 0.5
    max_acceleration: Positive = 4.0
    max_angular_acceleration: Positive = 10.0
    max_jerk: Positive = 400.0
    max_angular_jerk: Positive = 1000.0
    lookahead: Seconds = 2.0

    def __post_init__(self) -> None:
        """Find the time constants of the filters."""
        linear = self.max_velocity, self.max_acceleration, self.max_jerk
        angular = self.max_angular_velocity, self.max_angular_acceleration, self.max_angular_jerk
        self._tau = np.repeat([_time_constant(*linear), _time_constant(*angular)], 3)

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return the outputs of both filters at rest."""
        return {"filtered": np.zeros((len(ee_pose), 6)), "velocity": np.zeros((len(ee_pose), 6))}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the pose that a target at the current velocity will have after `lookahead`."""
        return integrate(target_pose, state["velocity"], self.lookahead)

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the mean filtered twist of the next `dt` seconds."""
        first, second = state["filtered"], state["velocity"]
        # Where the EE would come to rest without further commands.
        rest_pose = integrate(ee_pose, self._tau * (first + second), 1.0)
        command = twist_between(rest_pose, target_pose, dt)
        command *= slowed(command, self.max_velocity, self.max_angular_velocity)[:, np.newaxis]
        periods = dt[:, np.newaxis] / self._tau
        decay, away = np.exp(-periods), first - command
        filtered = command + away * decay
        velocity = command + (second - command + away * periods) * decay
        moved = self._tau * (first + second - filtered - velocity) / dt[:, np.newaxis]
        return command + moved, {"filtered": filtered, "velocity": velocity}


def _time_constant(velocity: float, acceleration: float, jerk: float) -> float:
    return float(max(_ACCELERATION * velocity / acceleration, np.sqrt(_JERK * velocity / jerk)))
