"""Solids around robots: upright boxes and cylinders that stand or move to and fro."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinfeas.core import solid_kernels
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.spatial import Array, planar_pose

MOST_SOLIDS = 64
"""Largest number of places of a row."""

THIN = 1e-3
"""Least half extent that a negative margin leaves of a solid, metres."""

_SOLIDS = "solids."
_COLUMNS = (
    "x, y, yaw, half extents along its x and y, lowest and highest z, 1 for a cylinder or 0 for a "
    "box, velocity x and y, path length after which it turns back"
)
_TILTED = 0.01  # difference of the radii of cylinders that are almost upright, metres


@dataclass(frozen=True)
class Solids:
    """Solids of n rows, k places each, any of which may be empty."""

    pose: Array  # world x, y and yaw of each centre, shape (n, k, 3), metres and radians
    # half extents along its own x and y (for a cylinder, both its radius), lowest and highest z,
    # shape (n, k, 4), metres; a place with half extents of 0 is empty
    size: Array
    cylinder: NDArray[np.bool_]  # whether it is a cylinder instead of a box, shape (n, k)
    velocity: Array  # world velocity at the start, shape (n, k, 2), m/s; 0 if it does not move
    span: Array  # path length after which a moving solid turns back, shape (n, k), metres

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

    @staticmethod
    def from_table(table: ArrayLike) -> "Solids":
        """Return one row of solids from a `table`; raise KinfeasError if a number is invalid."""
        ends = np.cumsum((3, 4, 1, 2))
        pose, size, cylinder, velocity, span = np.split(_checked(table)[np.newaxis], ends, axis=2)
        return Solids(pose, size, cylinder[..., 0] > 0.0, velocity, span[..., 0])

    @property
    def table(self) -> Array:
        """Table with a line for each solid of the first row, shape (k, 11).

        A line has the values of pose, size, cylinder (0 or 1), velocity and span.
        """
        return np.column_stack([values[0, self.filled[0]] for values in vars(self).values()])

    @property
    def places(self) -> int:
        """Count of the places of a row."""
        return int(self.size.shape[1])

    @property
    def centre(self) -> Array:
        """World poses of the centres, shape (n, k, 7), metres."""
        centre = planar_pose(self.pose[..., 0], self.pose[..., 1], self.pose[..., 2])
        centre[..., 2] = self.size[..., 2:].mean(axis=-1)
        return centre

    @property
    def filled(self) -> NDArray[np.bool_]:
        """Whether a place holds a solid, shape (n, k)."""
        return np.all(self.size[..., :2] > 0.0, axis=-1)

    def each(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> "Solids":
        """Return the solids with `change` applied to each of their arrays."""
        return Solids(*map(change, vars(self).values()))

    def of(self, rows: NDArray[np.intp]) -> "Solids":
        """Return the solids of some rows."""
        return self.each(lambda values: values[rows])

    def repeated(self, n: int) -> "Solids":
        """Return the solids of the first row in each of n rows."""
        return self.of(np.zeros(n, dtype=np.intp))

    def beyond(self, places: int) -> "Solids":
        """Return the solids without the first `places` places of each row."""
        return self.only(slice(places, None)) if places else self

    def joined(self, other: "Solids") -> "Solids":
        """Return rows with the places of these solids, followed by those of `other`."""
        both = zip(vars(self).values(), vars(other).values(), strict=True)
        return Solids(*(np.concatenate(values, axis=1) for values in both))

    def only(self, places: slice | NDArray[np.intp]) -> "Solids":
        """Return the solids in some places of each row."""
        return self.each(lambda values: values[:, places])

    def wider(self, margin: float, above: float = 0.0) -> "Solids":
        """Return the solids grown by a margin sideways and by `above` above and below.

        A negative margin leaves half extents of `THIN` at least.
        """
        growth = np.where(self.filled[..., np.newaxis], [margin, margin, -above, above], 0.0)
        size = self.size + growth
        size[..., :2] = np.maximum(size[..., :2], np.minimum(self.size[..., :2], THIN))
        return replace(self, size=size)

    def put(self, rows: NDArray[np.intp], other: "Solids") -> "Solids":
        """Return these solids with `other` instead in some rows."""
        places = max(self.places, other.places)
        changed = Solids.empty(len(self.size), places)
        for name, values in vars(changed).items():
            values[:, : self.places] = getattr(self, name)
            values[rows] = 0
            values[rows, : other.places] = getattr(other, name)
        return changed

    def at(self, seconds: Array) -> "Solids":
        """Return the solids with their poses and velocities `seconds`, (n,), after their start."""
        speed = np.linalg.norm(self.velocity, axis=2)
        if not speed.any():
            return self
        moves = (speed > 0.0) & (self.span > 0.0)
        span = np.where(moves, self.span, 1.0)
        path = speed * np.asarray(seconds)[:, np.newaxis] % (2.0 * span)
        time = np.where(moves, np.minimum(path, 2.0 * span - path) / np.maximum(speed, 1e-12), 0.0)
        pose = self.pose.copy()
        pose[:, :, :2] += self.velocity * time[:, :, np.newaxis]
        back = (moves & (path > span))[:, :, np.newaxis]
        velocity = np.where(moves[:, :, np.newaxis], self.velocity, 0.0)
        return replace(self, pose=pose, velocity=np.where(back, -velocity, velocity))

    def gaps(self, points: Array) -> tuple[Array, Array]:
        """Return the horizontal and the vertical gaps from points to solids, shape (n, m, k).

        A gap of 0 is a touch or an overlap; empty places are infinitely far. The distance is the
        Euclidean norm of the two gaps.

        Args:
            points: Points of each row in the world, shape (n, m, 3), metres.
        """
        return solid_kernels.gaps(points, self.pose, self.size, self.cylinder)

    def swept(self, first: float, last: float) -> "Solids":
        """Return solids that cover these at constant velocity between two times, seconds."""
        arrays = self.pose, self.size, self.cylinder, self.velocity
        pose, size = solid_kernels.swept(*arrays, first, last)
        return replace(self, pose=pose, size=size)


def _checked(table: ArrayLike) -> Array:
    try:
        rows = np.array(table, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise KinfeasError(f"'solids' must be rows of 11 numbers, {_COLUMNS}: {error}") from error
    rows = rows if rows.size else np.empty((0, 11))
    if rows.ndim != 2 or rows.shape[1] != 11:
        raise KinfeasError(f"'solids' must be rows of 11 numbers, {_COLUMNS}")
    along, across, lowest, highest, kind, span = rows[:, [3, 4, 5, 6, 7, 10]].T
    rules = {
        f"numbers must be finite, within {FARTHEST:g}": (np.abs(rows) <= FARTHEST).all(axis=1),
        "half extents must be positive": (along > 0.0) & (across > 0.0),
        "the lowest z must not be above the highest": lowest <= highest,
        "must be 1 for a cylinder or 0 for a box": (kind == 0.0) | (kind == 1.0),
        "half extents of a cylinder must be equal": (kind == 0.0) | (abs(along - across) < _TILTED),
        "the path length must not be negative": span >= 0.0,
    }
    for rule, holds in rules.items():
        if not holds.all():
            raise KinfeasError(f"'solids.{int(holds.argmin())}': {rule}")
    return rows


class MovingSolids:
    """Solids of n episodes, and the time since each began.

    Attributes:
        start: Solids at the start of the episodes; no places without any.
        seconds: Time since the start, shape (n,).
        moving: Which rows have solids that move, shape (n,).
    """

    def __init__(self) -> None:
        self.start, self.seconds = Solids.empty(0), np.zeros(0)
        self._find_moving()

    def place(self, solids: Solids | None, rows: NDArray[np.intp], n: int) -> None:
        """Begin episodes with these solids, None for none, in some of n rows."""
        if len(self.seconds) != n:
            self.start, self.seconds = Solids.empty(n), np.zeros(n)
        if solids is not None or self.start.places:
            self.start = self.start.put(rows, solids or Solids.empty(len(rows)))
        self.seconds = self.seconds.copy()
        self.seconds[rows] = 0.0
        self._find_moving()

    def after(self, seconds: float = 0.0) -> Solids | None:
        """Return the solids as they will stand in some seconds, or None without any."""
        if not self.start.places:
            return None
        return self.start.at(self.seconds + seconds) if self.moving.any() else self.start

    def step(self, dt: float) -> None:
        """Let time pass."""
        self.seconds = self.seconds + dt

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state as arrays by name."""
        if not self.start.places:
            return {}
        arrays = {_SOLIDS + name: values for name, values in vars(self.start).items()}
        return {**arrays, f"{_SOLIDS}seconds": self.seconds}

    def restore(self, snapshot: Mapping[str, NDArray[Any]], n: int) -> None:
        """Continue from a state of n rows that `snapshot` returned."""
        self.start, self.seconds = Solids.empty(n), np.zeros(n)
        if f"{_SOLIDS}seconds" in snapshot:
            self.start = Solids(*(snapshot[_SOLIDS + field.name] for field in fields(Solids)))
            self.seconds = snapshot[f"{_SOLIDS}seconds"]
        self._find_moving()

    def _find_moving(self) -> None:
        self.moving = np.any(self.start.velocity != 0.0, axis=(1, 2))


def stacked_solids(solids: Sequence[Solids]) -> Solids:
    """Return rows of solids as one batch; rows with fewer solids get empty places."""
    places, none = max(rows.places for rows in solids), np.arange(0)
    padded = [vars(rows.put(none, Solids.empty(0, places))).values() for rows in solids]
    return Solids(*map(np.concatenate, zip(*padded, strict=True)))
