"""Projection of points into half-spaces."""

import numpy as np

from kinfeas.kinematics.kernels import inlined, kernel

_ROUNDS = 100
"""Half-spaces at most that are taken up, some of them again; most points take fewer than five."""

_SHARES = (1.0, 0.5, 0.0)
"""Shares of negative offsets that are tried, until there is a point in all half-spaces."""

_PARALLEL = 1e-9
"""Squared sine of the angle to others below which a normal depends on them."""


@kernel
def project(points, normals, offsets, slack):
    """Move points (n, t, a) into the half-spaces of their row; return which were outside, (n, t).

    The half-spaces are `normals @ point <= offsets`, shapes (n, k, a) and (n, k); `slack` is
    allowed, above 0. Where no point is in all of them, negative offsets are raised up to 0; a point
    that still finds no place moves to the origin, which is in all half-spaces then.
    """
    n, t, _ = points.shape
    outside = np.zeros((n, t), dtype=np.bool_)
    for row in range(n):
        for one in range(t):
            point = points[row, one]
            if _worst(point, normals[row], offsets[row])[1] > slack:
                outside[row, one] = True
                _bring_inside(point, normals[row], offsets[row], slack)
    return outside


@kernel
def _bring_inside(point, normals, offsets, slack):
    """Move a point (a,) into all half-spaces."""
    start, lowest = point.copy(), min(offsets.min(), 0.0)
    for share in _SHARES:
        point[:] = start
        if _move(point, normals, np.maximum(offsets, share * lowest), slack):
            return
        if lowest == 0.0:
            break
    point[:] = 0.0


@kernel
def _move(point, normals, offsets, slack):
    """Move a point (a,) to the nearest one of all half-spaces; return whether there is one.

    Goldfarb and Idnani, "A numerically stable dual method for solving strictly convex quadratic
    programs", 1983: the half-space that is exceeded most is taken up, and those are let go whose
    border then no longer pushes the point.
    """
    count = 0
    borders, pushes = np.empty(len(point), dtype=np.int64), np.empty(len(point))
    for _ in range(_ROUNDS):
        worst, excess = _worst(point, normals, offsets)
        if excess <= slack:
            return True
        normal, push = normals[worst], 0.0
        while True:
            shares = _shares(normals, borders[:count], normal)
            ahead = normal - normals[borders[:count]].T @ shares
            square = _dot(ahead, ahead)
            free = count < len(point) and square > _PARALLEL * _dot(normal, normal)
            step, last = (excess / square if free else np.inf), -1
            for i in range(count):
                if shares[i] > 0.0 and pushes[i] < step * shares[i]:
                    step, last = pushes[i] / shares[i], i
            if step == np.inf:
                return False
            if free:
                point -= step * ahead
                excess -= step * square
            pushes[:count] -= step * shares
            push += step
            if last < 0:
                borders[count], pushes[count] = worst, push
                count += 1
                break
            count -= 1
            borders[last:count] = borders[last + 1 : count + 1].copy()
            pushes[last:count] = pushes[last + 1 : count + 1].copy()
    return False


@kernel
def _shares(normals, borders, normal):
    """Return shares, (b,), of the normals of b borders whose sum is nearest to a normal, (a,)."""
    chosen = normals[borders]
    return np.linalg.solve(chosen @ chosen.T, chosen @ normal)


@inlined
def _worst(point, normals, offsets):
    """Return the half-space that a point exceeds most, and by how much."""
    worst, excess = 0, -np.inf
    for i in range(len(offsets)):
        over = _dot(normals[i], point) - offsets[i]
        if over > excess:
            worst, excess = i, over
    return worst, excess


@inlined
def _dot(one, other):
    total = 0.0
    for i in range(len(one)):
        total += one[i] * other[i]
    return total
