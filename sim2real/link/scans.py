"""Scans around a base from planar lasers and costmaps; beams as in `Scan`."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import SCAN_BEAMS, SCAN_RANGE, Scan
from kinfeas.core.spatial import Array, wrap

ANGLES = -np.pi + 2.0 * np.pi / SCAN_BEAMS * np.arange(SCAN_BEAMS)
"""Angles of the beams to the heading, shape (b,)."""

OCCUPIED, UNKNOWN = 100, -1
"""Values of cells that are occupied for certain, and of those without a measurement."""


@dataclass(frozen=True)
class LaserReading:
    """Ranges of a planar laser."""

    ranges: Array  # metres, shape (m,); +inf is no return, -inf too near, NaN no measurement
    angle_min: float  # angle of the first ray to the laser's x axis, radians
    angle_increment: float  # angle from each ray to the next, radians
    range_min: float = 0.0  # shortest valid range, metres
    range_max: float = np.inf  # longest valid range, metres
    # x, y and yaw of the laser in the base frame, metres and radians
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stamp: float | None = None  # as in `BaseReading`


@dataclass(frozen=True)
class CostmapReading:
    """A grid of obstacles on the floor."""

    # 0 free to 100 occupied, -1 unknown, shape (rows along y, columns along x)
    cells: NDArray[np.int8]
    resolution: float  # edge of a cell, metres
    # x, y and yaw of the outer corner of the first cell in the world, metres and radians
    origin: tuple[float, float, float]
    occupied: int = OCCUPIED  # lowest value of an obstacle
    stamp: float | None = None  # as in `BaseReading`


def laser_ranges(laser: LaserReading) -> Array:
    """Return the range of the nearest measured point in the sector of each beam, shape (b,).

    It is `SCAN_RANGE` in a sector without such a point, and NaN in one without rays or with NaN
    rays only. A laser without any valid reading, or with invalid limits or angles, is all NaN.
    """
    ranges = laser.ranges.copy()
    ranges[ranges == -np.inf] = laser.range_min
    rays = np.arange(len(ranges), dtype=np.float64)
    heading = laser.mount[2] + laser.angle_min + laser.angle_increment * rays
    sound = laser.range_min < laser.range_max and np.isfinite(heading).all()
    if not (sound and np.any(ranges >= laser.range_min)):  # also if they are not numbers
        return np.full(SCAN_BEAMS, np.nan)
    nearest = np.full(SCAN_BEAMS, np.nan)
    measured = heading[~np.isnan(ranges)]
    nearest[_sectors(laser, measured, np.full(len(measured), SCAN_RANGE))[0]] = SCAN_RANGE
    valid = (ranges >= laser.range_min) & (ranges < laser.range_max) & np.isfinite(ranges)
    beams, distances = _sectors(laser, heading[valid], ranges[valid])
    np.fmin.at(nearest, beams, np.minimum(distances, SCAN_RANGE))
    return nearest


def _sectors(laser: LaserReading, heading: Array, ranges: Array) -> tuple[NDArray[np.intp], Array]:
    """Return beams and distances from the base of points on rays of a laser."""
    x = laser.mount[0] + ranges * np.cos(heading)
    y = laser.mount[1] + ranges * np.sin(heading)
    return beam(np.arctan2(y, x)), np.hypot(x, y)


def beam(angle: Array) -> NDArray[np.intp]:
    """Return the numbers of the beams nearest to angles to the heading, radians."""
    number = np.rint((angle + np.pi) * (SCAN_BEAMS / (2.0 * np.pi)))
    return number.astype(np.intp) % SCAN_BEAMS


def costmap_ranges(costmap: CostmapReading, base: tuple[float, float, float]) -> Array:
    """Return the ranges of beams to the first occupied cells, shape (b,).

    They are `SCAN_RANGE` without such a cell, also beyond the map. Beams are NaN if most of their
    cells in the map, up to an obstacle, are unknown. `base` is x, y and yaw in the world.
    """
    x, y, yaw = base
    distances = np.arange(0.0, SCAN_RANGE, 0.5 * costmap.resolution)
    left, up, angle = costmap.origin
    angles = (yaw - angle) + ANGLES[:, np.newaxis]
    cosine, sine = np.cos(angle), np.sin(angle)
    u = cosine * (x - left) + sine * (y - up) + distances * np.cos(angles)
    v = cosine * (y - up) - sine * (x - left) + distances * np.sin(angles)
    columns, rows = np.floor(np.stack([u, v]) / costmap.resolution).astype(np.intp)
    height, width = costmap.cells.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    cells = costmap.cells[rows.clip(0, height - 1), columns.clip(0, width - 1)]
    values = np.where(inside, cells, 0)
    before = np.cumsum(values >= costmap.occupied, axis=1) == 0
    reached = np.append(distances, SCAN_RANGE)[before.sum(axis=1)]
    unknown = (before & inside & (values < 0)).sum(axis=1)
    mapped = (before & inside & (values >= 0)).sum(axis=1)
    blind = (unknown > mapped) | ~inside.any(axis=1)
    return np.where(blind, np.nan, reached)


def combined(low: Array | None, high: Array | None, age: float) -> Scan:
    """Return the scan of the ranges of a laser and of a costmap, shape (b,), NaN where blind.

    Where one of them is missing or blind, its band has the ranges of the other. If a laser measures
    nothing at all, all beams are blind.
    """
    nothing = np.full(SCAN_BEAMS, np.nan)
    bands = np.stack([nothing if ranges is None else ranges for ranges in (low, high)])
    bands = np.where(np.isnan(bands), bands[::-1], bands)
    blind = np.isnan(bands[0])
    if low is not None and np.isnan(low).all():
        blind = np.ones_like(blind)
    ranges = np.where(np.isnan(bands), SCAN_RANGE, bands)
    return Scan(ranges[np.newaxis], blind, age)


def costmap_of(
    ranges: Array, base: tuple[float, float, float], edge: float, resolution: float
) -> CostmapReading:
    """Return a square costmap around a base with the first obstacle of each beam.

    Obstacles are two cells deep, and cells behind them unknown. `base` is x, y and yaw in the
    world, in metres and radians; `edge` and `resolution` are the side lengths of the map, which
    lies along the axes of the world, and of its cells, in metres.
    """
    x, y, yaw = base
    count = round(edge / resolution)
    left, up = (resolution * round((at - 0.5 * edge) / resolution) for at in (x, y))
    centres = (np.arange(count) + 0.5) * resolution
    dx, dy = left + centres - x, (up + centres - y)[:, np.newaxis]
    ends = np.where(ranges < SCAN_RANGE, ranges, np.inf)
    behind = np.hypot(dx, dy) - ends[beam(wrap(np.arctan2(dy, dx) - yaw))]
    cells = np.where(behind >= -0.5 * resolution, OCCUPIED, 0)
    cells = np.where(behind > 2.0 * resolution, UNKNOWN, cells)
    return CostmapReading(cells.astype(np.int8), resolution, (left, up, 0.0))
