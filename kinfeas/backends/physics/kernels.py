"""Compiled setpoints of arms and bases."""

import math

import numpy as np
from numba import njit

from kinfeas.core.pose_kernels import inlined, wrapped

# Explicit options, because those of the first caller would decide the last bits.
kernel = njit(cache=True, error_model="numpy", fastmath=False, nogil=True)


@kernel
def arm_paths(at, velocity, targets, continuous, fastest, horizon, time):
    """Return the paths of `ArmSetpoints.plan` and their velocities, shape (m, t, j)."""
    m, j = targets.shape
    path = np.empty((m, len(time), j))
    speed = np.empty_like(path)
    for i in range(m):
        change, needed = targets[i] - at[i], horizon
        for k in range(j):
            if continuous[k]:
                change[k] = wrapped(change[k])
            # The peak velocity of a cubic from rest is 1.5 times its mean.
            needed = max(needed, 1.5 * abs(change[k]) / fastest[k])
        # Larger changes are scaled down for all joints alike, because the EE deviates less if no
        # joint runs ahead.
        change *= horizon / needed
        for n in range(len(time)):
            for k in range(j):
                path[i, n, k], speed[i, n, k] = cubic(
                    at[i, k], velocity[i, k], change[k], horizon, time[n]
                )
    return path, speed


@inlined
def cubic(position, velocity, change, duration, time):
    """Return position and velocity on a cubic that ends at rest after `duration` seconds.

    Args:
        position: Start, rad or m.
        velocity: At the start.
        change: From start to end.
        duration: Seconds.
        time: Seconds since the start.
    """
    s = min(time / duration, 1.0)
    rest = 1.0 - s
    path = position + velocity * duration * s * rest * rest + change * s * s * (3.0 - 2.0 * s)
    return path, velocity * rest * (1.0 - 3.0 * s) + 6.0 * change / duration * s * rest


@kernel
def base_path(base, rows, twist, yaw, time, differential, acceleration, rotation_acceleration):
    """Return setpoints of x, y and yaw at t times within the acceleration limits, (m, t, 3).

    A differential drive moves along its heading only, at the part of the twist along its heading at
    the end of the period, as in `kinfeas.kinematics.drive`.

    Args:
        base: Velocity setpoints of all n robots, (n, 3), of a differential drive forward, 0 and
            yaw; those of `rows` become the last ones.
        rows: The m robots.
        twist: Their world twists, (m, 6).
        yaw: Headings of all n robots.
        time: Seconds since the command, (t,), at equal intervals.
        differential: Whether the drive is a differential one.
        acceleration: Limit, m/s^2.
        rotation_acceleration: Limit, rad/s^2.
    """
    path = np.empty((len(rows), len(time), 3))
    for i in range(len(rows)):
        row = rows[i]
        x, y, turn, heading = twist[i, 0], twist[i, 1], twist[i, 5], yaw[row]
        if differential:
            end = heading + turn * time[-1]
            x, y = math.cos(end) * x + math.sin(end) * y, 0.0
        change_x, change_y, change_turn = x - base[row, 0], y - base[row, 1], turn - base[row, 2]
        needed = max(math.hypot(change_x, change_y) / acceleration, 1e-9)
        needed_turn = max(abs(change_turn) / rotation_acceleration, 1e-9)
        for k in range(len(time)):
            share, share_turn = min(time[k] / needed, 1.0), min(time[k] / needed_turn, 1.0)
            x, y = base[row, 0] + share * change_x, base[row, 1] + share * change_y
            turn = base[row, 2] + share_turn * change_turn
            heading += turn * time[0]
            path[i, k, 0] = math.cos(heading) * x if differential else x
            path[i, k, 1] = math.sin(heading) * x if differential else y
            path[i, k, 2] = turn
        base[row, 0], base[row, 1], base[row, 2] = x, y, turn
    return path
