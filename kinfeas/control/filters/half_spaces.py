"""The nearest of what a few linear limits allow."""

import numpy as np

from kinfeas.kinematics.kernels import inlined, kernel

_ROUNDS = 1000
"""Of the projection, at most; most take fewer than ten."""


@kernel
def project(points, normals, offsets, slack):
    """Bring points into half-spaces, and return which were outside, shape (n, t).

    By projections on one half-space after the other (Hildreth, "A quadratic programming procedure",
    1957). What is left of a breach, where many of them are nearly parallel, is scaled away: the
    origin is within all of them.

    Args:
        points: Where they are, shape (n, t, a), t for each row; where they come to, after it.
        normals: Of k half-spaces a row, shape (n, k, a): `normals @ point <= offsets`.
        offsets: Shape (n, k), at least 0.
        slack: By which an offset may be exceeded, above 0.
    """
    n, t, _ = points.shape
    outside = np.zeros((n, t), dtype=np.bool_)
    for row in range(n):
        for one in range(t):
            point = points[row, one]
            if _excess(point, normals[row], offsets[row]) > slack:
                outside[row, one] = True
                pushes = np.zeros(offsets.shape[1])
                for _ in range(_ROUNDS):
                    if _push(point, normals[row], offsets[row], pushes) <= slack:
                        break
                _shrink(point, normals[row], offsets[row], slack)
    return outside


@inlined
def _excess(point, normals, offsets):
    """Return by how much the worst of the offsets is exceeded."""
    worst = -np.inf
    for i in range(len(offsets)):
        worst = max(worst, _dot(normals[i], point) - offsets[i])
    return worst


@inlined
def _push(point, normals, offsets, pushes):
    """Project on each half-space in turn; return by how much the farthest one was moved along."""
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
