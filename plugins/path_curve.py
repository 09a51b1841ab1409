"""Paths as uniform cubic B-splines: positions, lengths, and curves through corners."""

import math

import numpy as np

from kinfeas.plugins.path_clearance import distances, kernel, squared_way

POINTS = 64
"""Control points of a path."""

_WINDOW = 0.35
"""Length of the moving average that rounds corners, metres."""


@kernel
def positions_at(points, share, out):
    """Write the positions of n paths at shares in [0, 1] of their way, shape (n, 3).

    A path is a uniform cubic B-spline from its first to its last control point.
    """
    for i in range(len(share)):
        out[i] = on_curve(points[i], share[i] * (POINTS - 1))


@kernel
def shares_ahead(points, share, distances, out):
    """Write the shares of paths that lie some metres ahead, (n,) and (d,) -> (n, d), at most 1."""
    for i in range(len(share)):
        t = share[i] * (POINTS - 1)
        first = min(int(t), POINTS - 2)
        for d in range(len(distances)):
            left, k, done = distances[d], first, t - first
            while k < POINTS - 1:
                length = math.sqrt(squared_way(on_curve(points[i], k), on_curve(points[i], k + 1)))
                if left <= length * (1.0 - done):
                    done += left / max(length, 1e-12)
                    break
                left -= length * (1.0 - done)
                k, done = k + 1, 0.0
            out[i, d] = min((k + min(done, 1.0)) / (POINTS - 1), 1.0)


@kernel
def on_curve(points, t):
    """Return the position of a path at `t` control points from its beginning, shape (3,)."""
    k = min(int(t), POINTS - 2)
    u = t - k
    b, c = points[k], points[k + 1]
    a = points[k - 1] if k > 0 else 2.0 * b - c
    d = points[k + 2] if k < POINTS - 2 else 2.0 * c - b
    v = 1.0 - u
    p, q = v * v * v, u * u * u
    return (
        p * a + (4.0 - 6.0 * u * u + 3.0 * q) * b + (4.0 - 6.0 * v * v + 3.0 * p) * c + q * d
    ) / 6.0


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
    for i in range(2 * POINTS - 1):
        a, b = on_curve(points, 0.5 * i), on_curve(sharp, 0.5 * i)
        near = distances(table, a[0], a[1], a[2], radius)[0] < radius
        if near and distances(table, b[0], b[1], b[2], radius)[0] >= radius:
            return True
    return False
