"""Solids around robots: upright boxes and cylinders that stand or move to and fro."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array

MOST_SOLIDS = 64
"""Largest number of places of a row."""


@dataclass(frozen=True)
class Solids:
    """Solids of n rows, k places each, any of which may be empty.

    Attributes:
        pose: World x, y and yaw of each centre, shape (n, k, 3), metres and radians.
        size: Half extents along the solid's own x and y (of a cylinder, its radius twice), lowest
            and highest z, shape (n, k, 4), metres. A place with half extents of 0 is empty.
        cylinder: Whether it is a cylinder and no box, shape (n, k).
        velocity: World velocity at the start, shape (n, k, 2), m/s; 0 if it stands.
        span: Way after which a moving solid turns back, shape (n, k), metres.
    """

    pose: Array
    size: Array
    cylinder: NDArray[np.bool_]
    velocity: Array
    span: Array

    @staticmethod
    def empty(n: int, places: int = 0) -> "Solids":
        """Return n rows of empty places."""
        return Solids(
            pose=np.zeros((n, places, 3)),
            size=np.zeros((n, places, 4)),
            cylinder=np.zeros((n, places), dtype=np.bool_),
            velocity=np.zeros((n, places, 2)),
            span=np.zeros((n, places)),
        )

    def of(self, rows: NDArray[np.intp]) -> "Solids":
        """Return the solids of some rows."""
        return Solids(*(getattr(self, one.name)[rows] for one in fields(self)))

    def put(self, rows: NDArray[np.intp], other: "Solids") -> "Solids":
        """Return these solids with other ones, of as many places, in some rows."""
        changed = {one.name: getattr(self, one.name).copy() for one in fields(self)}
        for name, values in changed.items():
            values[rows] = getattr(other, name)
        return Solids(**changed)

    def at(self, seconds: Array) -> "Solids":
        """Return the solids as they stand some seconds, shape (n,), after their start."""
        speed = np.linalg.norm(self.velocity, axis=2)
        if not speed.any():
            return self
        moves = (speed > 0.0) & (self.span > 0.0)
        span = np.where(moves, self.span, 1.0)
        way = speed * np.asarray(seconds)[:, np.newaxis] % (2.0 * span)
        share = np.where(moves, np.minimum(way, 2.0 * span - way) / np.maximum(speed, 1e-12), 0.0)
        pose = self.pose.copy()
        pose[:, :, :2] += self.velocity * share[:, :, np.newaxis]
        return replace(self, pose=pose)


def stacked_solids(solids: Sequence[Solids]) -> Solids:
    """Return rows of solids as one batch; empty places fill up those with fewer."""
    places = max(one.pose.shape[1] for one in solids)
    joined = Solids.empty(sum(len(one.pose) for one in solids), places)
    row = 0
    for one in solids:
        rows = slice(row, row + len(one.pose))
        for entry in fields(Solids):
            values = getattr(one, entry.name)
            getattr(joined, entry.name)[rows, : values.shape[1]] = values
        row = rows.stop
    return joined
