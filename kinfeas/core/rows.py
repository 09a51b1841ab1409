"""Rows of batched arrays, which are replaced and never written into, since others may hold them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.motion import State

Rows = NDArray[np.intp]
"""Indices along the leading axis."""


def with_rows(array: NDArray[Any], rows: Rows, values: NDArray[Any]) -> NDArray[Any]:
    """Return `array` with `values` in its `rows`."""
    changed = array.copy()
    changed[rows] = values
    return changed


def of_rows(state: State, rows: Rows) -> State:
    """Return the state of some rows."""
    return {key: values[rows] for key, values in state.items()}


def merged(state: State, rows: Rows, values: State, n: int) -> State:
    """Return the state of n rows with `values` put into `rows`; a state that is empty has none.

    Both have the same keys, types and shapes, which `CheckedMotion` sees to.
    """
    if len(rows) == n:
        return values
    return {
        key: with_rows(state.get(key, np.zeros((n, *new.shape[1:]), new.dtype)), rows, new)
        for key, new in values.items()
    }
