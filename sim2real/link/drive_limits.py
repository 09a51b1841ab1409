"""Limits of what a base and an arm are commanded: pure functions, one robot."""

from dataclasses import dataclass

import numpy as np

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Base, Robot


@dataclass(frozen=True)
class DriveLimits:
    """How fast a base may be told to drive, and how fast that may change.

    Attributes:
        max_linear_velocity: m/s.
        max_angular_velocity: rad/s.
        acceleration: m/s^2.
        rotation_acceleration: rad/s^2.
        sideways: Whether it can drive in any direction.
    """

    max_linear_velocity: float
    max_angular_velocity: float
    acceleration: float
    rotation_acceleration: float
    sideways: bool

    @staticmethod
    def of(base: Base) -> "DriveLimits":
        """Return the limits of a robot's own base."""
        return DriveLimits(
            base.max_velocity,
            base.max_rotation,
            base.max_acceleration,
            base.max_rotation_acceleration,
            base.drive == "omnidirectional",
        )

    def clamp(self, velocity: Array, before: Array, dt: float) -> Array:
        """Return the nearest velocity that is allowed after another.

        Args:
            velocity: Forward, left and turning, shape (3,), m/s and rad/s.
            before: What was commanded before, of the same form.
            dt: Seconds between the two.
        """
        wanted = velocity.copy()
        if not self.sideways:
            wanted[1] = 0.0
        wanted[:2] = _shorten(wanted[:2], self.max_linear_velocity)
        wanted[2] = np.clip(wanted[2], -self.max_angular_velocity, self.max_angular_velocity)
        change = wanted - before
        change[:2] = _shorten(change[:2], self.acceleration * dt)
        most = self.rotation_acceleration * dt
        change[2] = np.clip(change[2], -most, most)
        return before + change


def to_drive(base: Base, base_pose: Array, base_twist: Array, dt: float) -> Array:
    """Return a world twist, shape (6,), as forward, left and turning, shape (3,).

    The inverse of `from_drive`; what a base on a floor cannot do is left out.
    """
    along = _heading(base, base_pose, base_twist[5], dt)
    forward = base_twist[:2] @ along
    left = base_twist[1] * along[0] - base_twist[0] * along[1]
    return np.array([forward, left, base_twist[5]])


def from_drive(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the world twist, shape (6,), that drives a base for `dt` seconds.

    Args:
        base: How it drives, as in `drive.base_twist`.
        base_pose: World pose of the base, shape (7,).
        velocity: Forward, left and turning, shape (3,), m/s and rad/s.
        dt: Duration in seconds.
    """
    forward, left, turning = velocity.tolist()
    x, y = _heading(base, base_pose, turning, dt).tolist()
    return np.array([x * forward - y * left, y * forward + x * left, 0.0, 0.0, 0.0, turning])


def arm_go(robot: Robot, before: Array, move: Array) -> Array:
    """Return where joints come to that go so far, shape (j,), within their limits."""
    lower, upper = robot.joint_limits
    after = np.where(robot.continuous, spatial.wrap(before + move), before + move)
    # A joint that begins beyond a limit is not made to jump there.
    return np.clip(after, np.minimum(lower, before), np.maximum(upper, before))


def _heading(base: Base, base_pose: Array, turning: float, dt: float) -> Array:
    """Return the direction that a base calls forward, shape (2,), in the world."""
    heading = float(spatial.yaw(base_pose))
    if base.drive != "omnidirectional":  # which drives along its new heading
        heading += turning * dt
    return np.array([np.cos(heading), np.sin(heading)])


def _shorten(vector: Array, most: float) -> Array:
    length = float(np.hypot(*vector))
    return vector if length <= most else vector * (most / length)
