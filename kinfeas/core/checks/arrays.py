"""Arrays that code from outside returns: whether they are sound, and what they are instead."""

import math
from typing import Any

import numpy as np

from kinfeas.core.spatial import Array

_UNIT_LENGTH = 1e-6  # by which the length of a quaternion may be off


def sound(value: Any, shape: tuple[int, ...]) -> bool:
    """Return whether an answer surely is an array of `shape`, of floats that are finite.

    It is for each step, so as cheap as can be: what is not sure may be sound all the same.
    """
    if type(value) is not np.ndarray or value.shape != shape or value.dtype != np.float64:
        return False
    # One product looks at all numbers at once; what overflows is looked at again.
    return math.isfinite(np.vdot(value, value))


def instead(value: object, shape: tuple[int, ...]) -> str:
    """Return what an answer is that is to be an array of numbers of `shape`; nothing if it is that.

    The end of a sentence: `list`, `(3, 5)` or `an array of object`.
    """
    if not isinstance(value, np.ndarray):
        return type(value).__name__
    if value.shape != shape:
        return str(value.shape)
    return "" if value.dtype.kind in "iuf" else f"an array of {value.dtype}"


def are_unit(poses: Array) -> bool:
    """Return whether all quaternions of poses, shape (..., 7), are of unit length; NaN is not."""
    off = np.abs(np.linalg.norm(poses[..., 3:], axis=-1) - 1.0).max(initial=0.0)
    return bool(off < _UNIT_LENGTH)
