"""Kernels of base drives, one robot at a time; `drive` says what they compute."""

import math

from kinfeas.core.kernel_cache import compiled
from kinfeas.core.pose_kernels import clipped, heading, inlined


@inlined
def _write_twist(pose, forward, left, turn, seconds, out):
    """Write the world twist of a base that has turned for some seconds."""
    angle = heading(pose) + turn * seconds
    cosine, sine = math.cos(angle), math.sin(angle)
    out[0], out[1] = cosine * forward - sine * left, sine * forward + cosine * left
    out[2], out[3], out[4], out[5] = 0.0, 0.0, 0.0, turn


@inlined
def within_speed(forward, left, fastest):
    """Return a planar velocity, slowed down to the fastest one."""
    scale = fastest / max(math.sqrt(forward * forward + left * left), fastest)
    return forward * scale, left * scale


@compiled(["void(f8[:], f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(a),(l),(),(t)->(t)")
def base_twist(pose, action, limits, dt, like, out):
    """World twist of an action, whose size tells the drive."""
    fastest = limits[0]
    forward, turn = clipped(action[0]) * fastest, clipped(action[-1]) * limits[1]
    if len(action) == 2:
        _write_twist(pose, forward, 0.0, turn, dt, out)
    else:
        forward, left = within_speed(forward, clipped(action[1]) * fastest, fastest)
        _write_twist(pose, forward, left, turn, 0.0, out)


@compiled(["void(f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(v),(),(t)->(t)")
def world_twist(pose, velocity, seconds, like, out):
    """World twist of a velocity of a base that has turned for some seconds."""
    _write_twist(pose, velocity[0], velocity[1], velocity[2], seconds, out)


@compiled(["void(f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(t),(),(v)->(v)")
def base_velocity(pose, twist, seconds, like, out):
    """Inverse of `world_twist`."""
    angle = heading(pose) + twist[5] * seconds
    cosine, sine = math.cos(angle), math.sin(angle)
    out[0], out[1] = cosine * twist[0] + sine * twist[1], cosine * twist[1] - sine * twist[0]
    out[2] = twist[5]


@inlined
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
    # Of the absolute value, since a velocity of -0 would point behind.
    bearing = math.atan2(left if forward >= 0.0 else -left, abs(forward))
    turn = min(max(bearing / dt, -fastest_turn), fastest_turn)
    along = forward * math.cos(turn * dt) + left * math.sin(turn * dt)
    out[0], out[1] = clipped(along / fastest), turn / fastest_turn


@compiled(["void(f8[:], f8[:], f8[:], f8, f8[:], f8[:])"], "(p),(u),(l),(),(a)->(a)")
def action_toward(pose, velocity, limits, dt, like, out):
    """Action that comes closest to a planar velocity."""
    write_action_toward(pose, velocity, limits, dt, out)
