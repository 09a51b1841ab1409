"""Base drives: commands into base motion."""

import numpy as np

from kinfeas.control import drive_kernels
from kinfeas.core.pose_kernels import TWIST
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Base


def command_size(base: Base) -> int:
    """Return the size of a base command: 3 (v_x, v_y, omega) or 2 (v, omega)."""
    return 3 if base.drive == "omnidirectional" else 2


def base_twist(base: Base, base_pose: Array, action: Array, dt: float) -> Array:
    """Return the world twist of an action, shape (n, 6), m/s and rad/s.

    Omnidirectional: translate with the old heading, then rotate; the planar speed is clipped by
    its norm. Differential: rotate, then drive along the new heading.

    Args:
        base: Drive and velocity limits.
        base_pose: World pose of the base, shape (n, 7).
        action: Shares of the limits, clipped to [-1, 1], shape (n, 3) or (n, 2).
        dt: Duration in seconds for which the twist will hold.
    """
    twist: Array = drive_kernels.base_twist(base_pose, action, _limits(base), dt, TWIST)
    return twist


def world_twist(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the world twist, shape (n, 6), of a velocity in the base frame, shape (n, 3).

    The velocity is forward, left and rotation, m/s and rad/s; other arguments as in `base_twist`.
    """
    twist: Array = drive_kernels.world_twist(base_pose, velocity, _turned_first(base, dt), TWIST)
    return twist


def base_velocity(base: Base, base_pose: Array, twist: Array, dt: float) -> Array:
    """Return the velocity in the base frame of a world twist, shape (n, 3), m/s and rad/s.

    The inverse of `world_twist`, without the components that a base on a floor cannot have.
    """
    seconds = _turned_first(base, dt)
    velocity: Array = drive_kernels.base_velocity(base_pose, twist, seconds, TWIST[:3])
    return velocity


def action_toward(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the action in [-1, 1] that comes closest to a planar world velocity (n, 2), m/s.

    An omnidirectional base copies it, without rotation. A differential one steers toward it,
    backwards if it points behind, and drives by the part of it that lies along the new heading.
    """
    like = TWIST[: command_size(base)]
    action: Array = drive_kernels.action_toward(base_pose, velocity, _limits(base), dt, like)
    return action


def _limits(base: Base) -> Array:
    """Return the limits of speed and rotation, for kernels."""
    return np.array([base.max_velocity, base.max_rotation])


def _turned_first(base: Base, dt: float) -> float:
    """Return the seconds for which a base has turned when its twist is computed."""
    return 0.0 if base.drive == "omnidirectional" else dt
