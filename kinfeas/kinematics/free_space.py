"""Free space on the floor: where the base of a robot can drive from its start."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.convex import BOX, SPHERE
from kinfeas.kinematics.self_collision import CollisionModel

_CELL, _MARGIN = 0.1, 3.0
"""Side of a cell of the grid, and width of the floor around all solids and the start, metres."""

_DIRECTIONS = 64


def footprint(model: CollisionModel) -> tuple[float, float]:
    """Return radius and height of a disc, metres, that the convex hull of the base contains.

    The disc is around the origin of the base frame, seen from above; its height is that of the
    lowest shape.
    """
    fixed = np.flatnonzero(model.body < 0).tolist()
    if not fixed:
        return 0.0, 0.0
    angle = 2.0 * np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
    around = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    reach = np.array([_support(model, s, around) for s in fixed]).max(axis=0)
    down = np.array([[0.0, 0.0, -1.0]])
    low = -max(float(_support(model, s, down)[0]) for s in fixed)
    return max(float(reach.min()), 0.0), max(low, 0.0)


def connected(
    solids: Solids, start: Array, places: Array, disc: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return whether a disc can be driven from a start to places, shape (m,).

    The answer is optimistic by the width of a cell. Moving solids are left out.

    Args:
        solids: In the world, one row.
        start: Position of the disc, shape (2,), metres.
        places: Positions to reach, shape (m, 2), metres.
        disc: Its radius and height, metres.
    """
    moving = np.any(solids.velocity != 0.0, axis=2, keepdims=True)
    size = np.where(moving, 0.0, solids.size)
    standing = Solids(solids.pose, size, solids.cylinder, solids.velocity, solids.span)
    known = np.concatenate([solids.pose[0, standing.filled[0], :2], start[np.newaxis], places])
    low, high = known.min(axis=0) - _MARGIN, known.max(axis=0) + _MARGIN
    x, y = (np.arange(low[i], high[i] + _CELL, _CELL) for i in (0, 1))
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((len(x), len(y)))], axis=-1)
    points[..., 2] = disc[1] + 1e-3
    planar, vertical = standing.gaps(points.reshape(1, -1, 3))
    blocked = (planar < disc[0] - _CELL) & (vertical <= 0.0)
    labels, _ = ndimage.label(~blocked.any(axis=2).reshape(len(x), len(y)))

    def part(positions: Array) -> NDArray[np.intp]:
        cells = np.rint((positions - low) / _CELL).astype(np.intp)
        found: NDArray[np.intp] = labels[cells[:, 0], cells[:, 1]]
        return found

    own = part(start[np.newaxis])[0]
    reached: NDArray[np.bool_] = (part(places) == own) & (own > 0)
    return reached


def _support(model: CollisionModel, s: int, directions: Array) -> Array:
    """Return how far a shape on the base reaches in unit directions, shape (d, 3) -> (d,)."""
    local, half = np.abs(directions @ model.rotation[s]), model.size[s]
    if model.kind[s] == BOX:
        reach = local @ half
    elif model.kind[s] == SPHERE:
        reach = np.full(len(local), half[0])
    else:
        reach = half[0] * np.hypot(local[:, 0], local[:, 1]) + half[2] * local[:, 2]
    total: Array = directions @ model.offset[s] + reach
    return total
