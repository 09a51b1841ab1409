"""Velocity limits of motions, and their positive parameters."""

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array

_TINY = 1e-12  # keeps quotients finite; in m/s and in rad/s
_LEAST, _MOST = 1e-9, 1e9  # of any parameter; beyond, motions would overflow or never end


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


def positive(name: str, value: float) -> float:
    """Return the parameter `value` as a float."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not _LEAST <= value <= _MOST:
        allowed = f"{_LEAST:g} to {_MOST:g} is allowed"
        raise KinfeasError(f"{name} must be a positive number, not {value!r}: {allowed}")
    return float(value)
