"""Paths as uniform cubic B-splines, and their distances to the solids of a row.

Solids of a row are a table with one line each: x, y, cosine and sine of the yaw, half extents,
lowest and highest z, the radius around it, and whether it is a cylinder; metres.
"""

import math

import numpy as np
from numba import njit

from kinfeas.core.kernel_cache import UNCOUNTED, compiled
from kinfeas.core.motion import WAYPOINTS
from kinfeas.core.pose_kernels import write_reached, write_twist

kernel = njit(cache=True, error_model="numpy", fastmath=False, nogil=True)
inner = njit(cache=True, error_model="numpy", fastmath=False, nogil=True, **UNCOUNTED)

POINTS = WAYPOINTS
"""Control points of a path."""

_WINDOW = 0.35
"""Length of the moving average that rounds corners, metres."""

_PENALTY, _DEEPEST = 4.0, 2.0
"""Costs of a way beside solids, as multiples of its length; see `cost_of_metre`."""


@kernel
def table_of(pose, size, cylinder, way):
    """Return the table of the solids of a row, each with the room on its way, shape (k, 2)."""
    table, count = np.empty((len(pose), 10)), 0
    for k in range(len(pose)):
        if size[k, 0] <= 0.0:
            continue
        a, b, x, y = size[k, 0], size[k, 1], 0.5 * way[k, 0], 0.5 * way[k, 1]
        row = table[count]
        row[0], row[1] = pose[k, 0] + x, pose[k, 1] + y
        row[2], row[3] = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        if cylinder[k]:
            a += math.sqrt(x * x + y * y)
        else:
            a, b = a + abs(row[2] * x + row[3] * y), b + abs(row[2] * y - row[3] * x)
        row[4], row[5], row[6], row[7] = a, b, size[k, 2], size[k, 3]
        row[8] = a if cylinder[k] else math.sqrt(a * a + b * b)
        row[9] = 1.0 if cylinder[k] else 0.0
        count += 1
    return table[:count]


@inner
def horizontal_gap(row, x, y):
    """Return the horizontal distance from a point to a solid, negative inside."""
    dx, dy = x - row[0], y - row[1]
    if row[9] > 0.0:
        return math.sqrt(dx * dx + dy * dy) - row[8]
    along = abs(row[2] * dx + row[3] * dy) - row[4]
    across = abs(row[2] * dy - row[3] * dx) - row[5]
    if along > 0.0 and across > 0.0:
        return math.sqrt(along * along + across * across)
    return max(along, across)


@inner
def distances(table, x, y, z, limit):
    """Return the distance to the nearest solid and the horizontal one, both at most `limit`."""
    nearest, beside = limit, limit
    for k in range(len(table)):
        row = table[k]
        dx, dy, reach = x - row[0], y - row[1], row[8] + limit
        if dx * dx + dy * dy >= reach * reach:
            continue
        gap = horizontal_gap(row, x, y)
        beside = min(beside, gap)
        above = max(max(row[6] - z, z - row[7]), 0.0)
        gap = max(gap, 0.0)
        nearest = min(nearest, math.sqrt(gap * gap + above * above))
    return nearest, beside


@inner
def cost_of_metre(beside, clearance):
    """Return the cost of a metre at a horizontal distance: 1 from the preferred clearance on."""
    depth = min(max((clearance - beside) / clearance, 0.0), _DEEPEST)
    return 1.0 + _PENALTY * depth * depth


@inner
def squared_way(a, b):
    """Return the squared distance of two points, shape (3,) each, m^2."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z


@kernel
def shares_ahead(points, share, distances, out):
    """Write the shares of paths that lie some metres ahead, (n,) and (d,) -> (n, d), at most 1."""
    lengths, ends = np.empty(POINTS - 1), np.empty((2, 3))
    for i in range(len(share)):
        t = share[i] * (POINTS - 1)
        measured = first = min(int(t), POINTS - 2)
        write_place(points[i], first, ends[first % 2])
        for d in range(len(distances)):
            left, k, done = distances[d], first, t - first
            while k < POINTS - 1:
                if k == measured:
                    write_place(points[i], k + 1, ends[(k + 1) % 2])
                    lengths[k] = math.sqrt(squared_way(ends[0], ends[1]))
                    measured += 1
                if left <= lengths[k] * (1.0 - done):
                    done += left / max(lengths[k], 1e-12)
                    break
                left -= lengths[k] * (1.0 - done)
                k, done = k + 1, 0.0
            out[i, d] = min((k + min(done, 1.0)) / (POINTS - 1), 1.0)


@inner
def write_place(points, t, out):
    """Write the place of a path at `t` control points from its beginning, or its first numbers."""
    k = min(int(t), POINTS - 2)
    u = t - k
    v = 1.0 - u
    p, q = v * v * v, u * u * u
    for i in range(len(out)):
        b, c = points[k, i], points[k + 1, i]
        a = points[k - 1, i] if k > 0 else 2.0 * b - c
        d = points[k + 2, i] if k < POINTS - 2 else 2.0 * c - b
        out[i] = (
            p * a + (4.0 - 6.0 * u * u + 3.0 * q) * b + (4.0 - 6.0 * v * v + 3.0 * p) * c + q * d
        ) / 6.0


@compiled(["void(f8[:, :], f8, f8[:])"], "(k,d),()->(d)")
def place_at(points, share, out):
    """Place of a path, a uniform cubic B-spline, at a share in [0, 1] of its way."""
    write_place(points, share * (POINTS - 1), out)


@compiled(["void(f8[:, :], f8, f8, f8[:], f8[:], f8[:])"], "(k,p),(),(),(p),(p)->(p)")
def pose_at(points, share, rate, origin, target, out):
    """Pose at a share of a path that ends at `origin`, which is bent so that it ends at `target`.

    Without a rate the motion is straight from `origin` to `target`.
    """
    way = np.empty(6)
    write_twist(origin, target, 1.0, way)
    if rate == 0.0:
        write_reached(origin, way, share, out)
        return
    write_place(points, share * (POINTS - 1), out)
    x, y, z, w = out[3], out[4], out[5], out[6]
    out[3:] /= math.sqrt(x * x + y * y + z * z + w * w)
    write_reached(out, way, share, out)


@inner
def phases(first, rate, ramp):
    """Return the seconds in which the rate of a motion changes, is constant, and falls to rest."""
    rate = max(rate, 1e-9)
    rise, fall = 0.0 if first == rate else ramp, min(ramp, 2.0 / rate)
    cruise = (1.0 - 0.5 * rise * (first + rate) - 0.5 * fall * rate) / rate
    return rise, max(cruise, 0.0), fall


@compiled(["void(f8, f8, f8, f8[:])"], "(),(),()->()")
def duration(first, rate, ramp, out):
    """Seconds that a motion takes: its rate rises or falls from the first one, in the end to 0."""
    rise, cruise, fall = phases(first, rate, ramp)
    out[0] = rise + cruise + fall


@inner
def _ramped(u):
    """Return the integral of the quintic step `10 u^3 - 15 u^4 + 6 u^5` from 0 to u in [0, 1]."""
    return u * u * u * u * (2.5 + u * (u - 3.0))


@compiled(["void(f8, f8, f8, f8, f8, f8[:])"], "(),(),(),(),()->()")
def share_after(time, seconds, first, rate, ramp, out):
    """Share of its path that a motion of some `seconds` has behind it after a time.

    Without a rate it is that of `minimum_jerk`.
    """
    if rate <= 0.0:
        s = time / seconds
        out[0] = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return
    rise, cruise, fall = phases(first, rate, ramp)
    share = 0.0
    if rise > 0.0:
        u = min(time / rise, 1.0)
        share = rise * (first * u + (rate - first) * _ramped(u))
    v = min(max((time - rise - cruise) / max(fall, 1e-9), 0.0), 1.0)
    share += rate * min(max(time - rise, 0.0), cruise)
    share += rate * fall * (v - _ramped(v))
    out[0] = min(share, 1.0)


@kernel
def smooth(corners, table, radius, points):
    """Write a path with rounded corners as control points at even steps, shape (64, 3).

    Each point is the mean of the path around it, over a length that is halved until the radius
    around the path is as free as around the corners.
    """
    count = len(corners)
    length, integral = np.zeros(count), np.zeros((count, 3))
    for i in range(1, count):
        step = math.sqrt(squared_way(corners[i - 1], corners[i]))
        length[i] = length[i - 1] + step
        integral[i] = integral[i - 1] + 0.5 * step * (corners[i - 1] + corners[i])
    window, sharp, total = _WINDOW, np.empty((POINTS, 3)), length[-1]
    for i in range(POINTS):
        sharp[i] = _at(corners, length, integral, total * i / (POINTS - 1))[:3]
    while True:
        for i in range(POINTS):
            s = total * i / (POINTS - 1)
            half = 0.5 * min(window, 2.0 * min(s, total - s))
            points[i] = sharp[i]
            if half > 1e-6:
                low = _at(corners, length, integral, s - half)[3:]
                high = _at(corners, length, integral, s + half)[3:]
                points[i] = (high - low) / (2.0 * half)
        points[0], points[-1] = corners[0], corners[-1]
        if window < 0.02 or not _worse(points, sharp, table, radius):
            return
        window *= 0.5


@kernel
def _at(corners, length, integral, s):
    """Return the position after `s` metres of a path and its integral until there, shape (6,)."""
    k = 1
    while k < len(length) - 1 and length[k] < s:
        k += 1
    done = min(max(s - length[k - 1], 0.0), length[k] - length[k - 1])
    share = done / max(length[k] - length[k - 1], 1e-12)
    both = np.empty(6)
    for i in range(3):
        both[i] = corners[k - 1, i] + share * (corners[k, i] - corners[k - 1, i])
        both[3 + i] = integral[k - 1, i] + 0.5 * done * (corners[k - 1, i] + both[i])
    return both


@kernel
def _worse(points, sharp, table, radius):
    """Return whether a path comes nearer than the radius where the other one does not."""
    a, b = np.empty(3), np.empty(3)
    for i in range(2 * POINTS - 1):
        write_place(points, 0.5 * i, a)
        write_place(sharp, 0.5 * i, b)
        near = distances(table, a[0], a[1], a[2], radius)[0] < radius
        if near and distances(table, b[0], b[1], b[2], radius)[0] >= radius:
            return True
    return False
