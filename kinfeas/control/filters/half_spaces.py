"""Projection of points into half-spaces."""

import numpy as np

from kinfeas.kinematics.kernels import inlined, kernel

_PROJECTIONS = 1000
"""Rounds of projections at most; most constraints take fewer than ten."""

_SHARES = (1.0, 0.5, 0.0)
"""Shares of negative offsets that are tried, until there is a point in all half-spaces."""


@kernel
def project(points, normals, offsets, slack):
    """Move points (n, t, a) into the half-spaces of their row; return which were outside, (n, t).

    The half-spaces are `normals @ point <= offsets`, shapes (n, k, a) and (n, k); `slack` is
    allowed, above 0. By projections on one half-space after the other (Hildreth, "A quadratic
    programming procedure", 1957). Where that does not converge, negative offsets are raised up to
    0; at last points are scaled towards the origin, which is in all half-spaces then.
    """
    n, t, _ = points.shape
    outside = np.zeros((n, t), dtype=np.bool_)
    for row in range(n):
        for one in range(t):
            point = points[row, one]
            if _excess(point, normals[row], offsets[row]) > slack:
                outside[row, one] = True
                _bring_inside(point, normals[row], offsets[row], slack)
    return outside


@kernel
def _bring_inside(point, normals, offsets, slack):
    """Move a point (a,) into all half-spaces."""
    start, lowest = point.copy(), min(offsets.min(), 0.0)
    raised = offsets
    for share in _SHARES:
        point[:] = start
        raised = np.maximum(offsets, share * lowest)
        pushes = np.zeros(len(offsets))
        for _ in range(_PROJECTIONS):
            if _push(point, normals, raised, pushes) <= slack:
                break
        if lowest == 0.0 or _excess(point, normals, raised) <= slack:
            break
    if raised.min() >= 0.0:
        _shrink(point, normals, raised, slack)


@inlined
def _excess(point, normals, offsets):
    """Return the largest excess over the offsets."""
    worst = -np.inf
    for i in range(len(offsets)):
        worst = max(worst, _dot(normals[i], point) - offsets[i])
    return worst


@inlined
def _push(point, normals, offsets, pushes):
    """Project on each half-space in turn; return the largest move along a normal."""
    farthest = 0.0
    for i in range(len(offsets)):
        square = _dot(normals[i], normals[i])
        if square > 0.0:
            over = _dot(normals[i], point) - offsets[i]
            push = max(pushes[i] + over / square, 0.0)
            for j in range(len(point)):
                point[j] -= (push - pushes[i]) * normals[i, j]
            farthest = max(farthest, abs(push - pushes[i]) * square)
            pushes[i] = push
    return farthest


@inlined
def _shrink(point, normals, offsets, slack):
    """Bring a point towards the origin until no offset is exceeded by more than `slack`."""
    scale = 1.0
    for i in range(len(offsets)):
        scale = max(scale, _dot(normals[i], point) / (offsets[i] + slack))
    for j in range(len(point)):
        point[j] /= scale


@inlined
def _dot(one, other):
    total = 0.0
    for i in range(len(one)):
        total += one[i] * other[i]
    return total
