"""Base drives: commands into base motion."""

import numpy as np

from kinfeas.core.pose_kernels import TWIST, planar_twist
from kinfeas.core.spatial import Array, yaw
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
    action = action.clip(-1.0, 1.0)
    velocity = np.zeros((len(action), 3))
    velocity[:, 0] = action[:, 0] * base.max_velocity
    velocity[:, 2] = action[:, -1] * base.max_rotation
    if base.drive == "omnidirectional":
        velocity[:, 0], velocity[:, 1] = _clip_speed(
            velocity[:, 0], action[:, 1] * base.max_velocity, base
        )
    return world_twist(base, base_pose, velocity, dt)


def world_twist(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the world twist, shape (n, 6), of a velocity in the base frame, shape (n, 3).

    The velocity is forward, left and rotation, m/s and rad/s; other arguments as in `base_twist`.
    """
    cosine, sine = _direction(base, base_pose, velocity[:, 2], dt)
    twist: Array = planar_twist(velocity, cosine, sine, TWIST)
    return twist


def base_velocity(base: Base, base_pose: Array, twist: Array, dt: float) -> Array:
    """Return the velocity in the base frame of a world twist, shape (n, 3), m/s and rad/s.

    The inverse of `world_twist`, without the components that a base on a floor cannot have.
    """
    cosine, sine = _direction(base, base_pose, twist[:, 5], dt)
    forward = cosine * twist[:, 0] + sine * twist[:, 1]
    left = cosine * twist[:, 1] - sine * twist[:, 0]
    return np.stack([forward, left, twist[:, 5]], axis=1)


def _direction(base: Base, base_pose: Array, rotation: Array, dt: float) -> tuple[Array, Array]:
    """Return cosine and sine of the heading along which the base drives, shape (n,) each."""
    heading = yaw(base_pose)
    if base.drive != "omnidirectional":
        heading = heading + rotation * dt
    return np.cos(heading), np.sin(heading)


def carried_out(action: Array) -> Array:
    """Return commands (..., 3) or (..., 2) clipped as in `base_twist`."""
    action = np.clip(action, -1.0, 1.0)
    action[..., :-1] /= np.maximum(np.linalg.norm(action[..., :-1], axis=-1, keepdims=True), 1.0)
    return action


def action_toward(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the action in [-1, 1] that comes closest to a planar world velocity (n, 2), m/s.

    An omnidirectional base copies it, without rotation. A differential one steers toward it,
    backwards if it points behind, and drives by the part of it that lies along the new heading.
    """
    heading = yaw(base_pose)
    cosine, sine = np.cos(heading), np.sin(heading)
    forward = cosine * velocity[:, 0] + sine * velocity[:, 1]
    left = cosine * velocity[:, 1] - sine * velocity[:, 0]
    if base.drive == "omnidirectional":
        forward, left = _clip_speed(forward, left, base)
        return np.stack([forward, left, np.zeros_like(left)], axis=1) / base.max_velocity
    # Of the absolute value, since a velocity of -0 would point behind.
    bearing = np.arctan2(np.where(forward >= 0.0, left, -left), np.abs(forward))
    turn = np.clip(bearing / dt, -base.max_rotation, base.max_rotation)
    along = forward * np.cos(turn * dt) + left * np.sin(turn * dt)
    action = np.stack([along / base.max_velocity, turn / base.max_rotation], axis=1)
    return np.clip(action, -1.0, 1.0)


def _clip_speed(forward: Array, left: Array, base: Base) -> tuple[Array, Array]:
    speed = np.sqrt(forward * forward + left * left)
    scale = base.max_velocity / np.maximum(speed, base.max_velocity)
    return forward * scale, left * scale
