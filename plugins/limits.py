"""Velocity limits of motions."""

import numpy as np

from kinfeas.core.spatial import Array

_TINY = 1e-12  # keeps quotients finite; in m/s and in rad/s


def slowed(twist: Array, max_velocity: float, max_angular_velocity: float) -> Array:
    """Return the factor in (0, 1] by which twists, (n, 6), must shrink to keep both limits, (n,).

    Limits and twists are in m/s and rad/s.
    """
    linear = max_velocity / np.maximum(norm(twist[:, :3]), _TINY)
    angular = max_angular_velocity / np.maximum(norm(twist[:, 3:]), _TINY)
    return np.minimum(1.0, np.minimum(linear, angular))


def norm(vector: Array) -> Array:
    """Return lengths, shape (n, 3) -> (n,); by elements, so that no row depends on the batch."""
    x, y, z = vector[:, 0], vector[:, 1], vector[:, 2]
    return np.sqrt(x * x + y * y + z * z)
