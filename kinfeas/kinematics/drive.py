"""Base drives: conversion between base commands, velocities and world twists."""

import math

import numpy as np

from kinfeas.core.kernels import compiled, exact_inlined
from kinfeas.core.pose_kernels import TWIST, clipped, heading
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
        action: Fractions of the limits, clipped to [-1, 1], shape (n, 3) or (n, 2).
        dt: Duration in seconds for which the twist will hold.
    """
    return _base_twist(base_pose, action, _limits(base), dt, TWIST)


def world_twist(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the world twist, shape (n, 6), of a velocity in the base frame, shape (n, 3).

    The velocity is forward, left (m/s) and angular (rad/s); other arguments as in `base_twist`.
    """
    return _world_twist(base_pose, velocity, _turn_seconds(base, dt), TWIST)


def base_velocity(base: Base, base_pose: Array, twist: Array, dt: float) -> Array:
    """Return the velocity in the base frame of a world twist, shape (n, 3), m/s and rad/s.

    The inverse of `world_twist`, without the components that a base on a floor cannot have.
    """
    seconds = _turn_seconds(base, dt)
    return _base_velocity(base_pose, twist, seconds, TWIST[:3])


def action_toward(base: Base, base_pose: Array, velocity: Array, dt: float) -> Array:
    """Return the action in [-1, 1] that comes closest to a planar world velocity (n, 2), m/s.

    An omnidirectional base takes this velocity without rotating. A differential base turns its
    front toward the velocity, or its back if the velocity points backwards, and then drives at the
    velocity's component along the new heading.
    """
    like = TWIST[: command_size(base)]
    return _action_toward(base_pose, velocity, _limits(base), dt, like)


def _limits(base: Base) -> Array:
    return np.array([base.max_velocity, base.max_rotation])


def _turn_seconds(base: Base, dt: float) -> float:
    """Return the seconds for which a base rotates before it drives along its new heading."""
    return 0.0 if base.drive == "omnidirectional" else dt


@exact_inlined
def _write_twist(pose, forward, left, turn, seconds, out):
    angle = heading(pose) + turn * seconds
    cosine, sine = math.cos(angle), math.sin(angle)
    out[0], out[1] = cosine * forward - sine * left, sine * forward + cosine * left
    out[2], out[3], out[4], out[5] = 0.0, 0.0, 0.0, turn


@exact_inlined
def within_speed(forward, left, fastest):
    """Return a planar velocity, slowed down to at most the speed `fastest`."""
    scale = fastest / max(math.sqrt(forward * forward + left * left), fastest)
    return forward * scale, left * scale


@compiled(["void(f8[:], f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(a),(l),(),(t)->(t)")
def _base_twist(pose, action, limits, dt, like, out):
    fastest = limits[0]
    forward, turn = clipped(action[0]) * fastest, clipped(action[-1]) * limits[1]
    if len(action) == 2:
        _write_twist(pose, forward, 0.0, turn, dt, out)
    else:
        forward, left = within_speed(forward, clipped(action[1]) * fastest, fastest)
        _write_twist(pose, forward, left, turn, 0.0, out)


@compiled(["void(f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(v),(),(t)->(t)")
def _world_twist(pose, velocity, seconds, like, out):
    _write_twist(pose, velocity[0], velocity[1], velocity[2], seconds, out)


@compiled(["void(f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(t),(),(v)->(v)")
def _base_velocity(pose, twist, seconds, like, out):
    angle = heading(pose) + twist[5] * seconds
    cosine, sine = math.cos(angle), math.sin(angle)
    out[0], out[1] = cosine * twist[0] + sine * twist[1], cosine * twist[1] - sine * twist[0]
    out[2] = twist[5]


@exact_inlined
def write_action_toward(pose, velocity, limits, dt, out):
    """Write the action that comes closest to a velocity, as `action_toward`."""
    angle, fastest, fastest_turn = heading(pose), limits[0], limits[1]
    cosine, sine = math.cos(angle), math.sin(angle)
    forward = cosine * velocity[0] + sine * velocity[1]
    left = cosine * velocity[1] - sine * velocity[0]
    if len(out) == 3:
        forward, left = within_speed(forward, left, fastest)
        out[0], out[1], out[2] = forward / fastest, left / fastest, 0.0
        return
    # With the absolute value, since a forward velocity of -0 would point backwards.
    bearing = math.atan2(left if forward >= 0.0 else -left, abs(forward))
    turn = min(max(bearing / dt, -fastest_turn), fastest_turn)
    along = forward * math.cos(turn * dt) + left * math.sin(turn * dt)
    out[0], out[1] = clipped(along / fastest), turn / fastest_turn


@compiled(["void(f8[:], f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(u),(l),(),(a)->(a)")
def _action_toward(pose, velocity, limits, dt, like, out):
    write_action_toward(pose, velocity, limits, dt, out)
