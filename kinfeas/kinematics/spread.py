"""Points that cover a cube evenly, without chance."""

import numpy as np

from kinfeas.core.spatial import Array


def spread(count: int, dimensions: int, first: int = 0) -> Array:
    """Return points number `first` to `first + count - 1` of the unit cube, (count, dimensions).

    The additive recurrence of the generalised golden ratio (Roberts, "The unreasonable
    effectiveness of quasirandom sequences", 2018). SciPy's sequences would do as well, but their
    import costs a deployed policy a sixth of its memory.
    """
    ratio = 2.0
    for _ in range(64):  # a fixed point of x^(d + 1) = x + 1
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1.0)
    points: Array = (0.5 + np.arange(first, first + count)[:, np.newaxis] * steps) % 1.0
    return points
