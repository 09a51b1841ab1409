"""Arithmetic on poses and on the halves of twists, in which no row depends on the batch."""

import numpy as np

from kinfeas.core.spatial import Array, integrate

_TINY = 1e-300  # keeps quotients finite


def length(vector: Array) -> Array:
    """Return lengths, shape (n, 3) -> (n, 1)."""
    squares = vector * vector
    return np.sqrt(squares[:, 0:1] + squares[:, 1:2] + squares[:, 2:3])


def shortened(vector: Array, longest: Array) -> Array:
    """Return vectors, shape (n, 3), as they are or shortened to `longest`, shape (n, 1)."""
    found = length(vector)
    return np.where(found > longest, vector * (longest / np.maximum(found, _TINY)), vector)


def displaced(pose: Array, by: Array) -> Array:
    """Return poses, shape (n, 7), moved and turned `by` m and rad, (n, 6), along world axes.

    A displacement of nothing leaves every bit as it is.
    """
    moved = np.any(by != 0.0, axis=1, keepdims=True)
    return np.where(moved, integrate(pose, by, 1.0), pose)
