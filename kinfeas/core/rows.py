"""Rows of batched arrays; arrays are copied, because they may be shared."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.motion import State

Rows = NDArray[np.intp]
"""Indices along the leading axis."""


def with_rows(array: NDArray[Any], rows: Rows, values: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of `array` with `values` in `rows`."""
    changed = array.copy()
    changed[rows] = values
    return changed


def of_rows(state: State, rows: Rows) -> State:
    """Return the state of `rows`."""
    return {key: values[rows] for key, values in state.items()}


def merged(state: State, rows: Rows, values: State, n: int) -> State:
    """Return the state of n rows with `values` in `rows`; other rows of an empty state are zero.

    Keys, types and shapes of both are equal, which `CheckedMotion` checks.
    """
    if len(rows) == n:
        return values
    return {
        key: with_rows(state.get(key, np.zeros((n, *new.shape[1:]), new.dtype)), rows, new)
        for key, new in values.items()
    }
