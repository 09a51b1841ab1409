"""Range scans around bases among solids."""

import math
from functools import cache

import numpy as np

from kinfeas.core.backend import SCAN_BANDS, SCAN_BEAMS, SCAN_RANGE
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.kernels import inlined, inner, kernel, square
from kinfeas.kinematics.solids import is_empty, squared_radius, surroundings, write_local


def scan(
    solids: Solids,
    base_pose: Array,
    bands: tuple[tuple[float, float], ...],
    beams: int,
    max_range: float,
) -> Array:
    """Return ranges around the bases in b bands of height, shape (n, b, beams), metres.

    Beam i has the angle -pi + 2 pi i / `beams` to the base's heading and begins at the origin of
    the base frame. Its range ends at the first solid of which a part is within the band, is 0
    inside of one and `max_range` without one.

    Args:
        solids: In the world, n rows.
        base_pose: World poses of the bases, on the floor, shape (n, 7).
        bands: Lowest and highest z of each band, metres.
        beams: Number of beams.
        max_range: Longest range, metres.
    """
    ranges = np.full((len(base_pose), len(bands), beams), float(max_range))
    around = surroundings(solids, base_pose, len(ranges))
    _scan_batch(*around, *_rays(bands, beams), float(max_range), ranges)
    return ranges


@cache
def _rays(bands: tuple[tuple[float, float], ...], beams: int) -> tuple[Array, Array, Array]:
    """Return bands, shape (b, 2), and cosines and sines of the angles of beams, for kernels."""
    angles = -np.pi + 2.0 * np.pi / beams * np.arange(beams)
    return np.array(bands).reshape(-1, 2), np.cos(angles), np.sin(angles)


def scan_now(solids: MovingSolids, base_pose: Array) -> Array:
    """Return the present ranges around bases, shape (n, 7), as in `Scan`."""
    present = solids.after() or Solids.empty(len(base_pose))
    return scan(present, base_pose, SCAN_BANDS, SCAN_BEAMS, SCAN_RANGE)


@kernel
def _scan_batch(base, solids, bands, cosine, sine, max_range, ranges):
    pose, size, cylinder = solids
    local = np.empty(pose.shape[1:])
    for i in range(len(base)):
        write_local(pose[i], base[i], local)
        _scan_row(local, size[i], cylinder[i], bands, cosine, sine, max_range, ranges[i])


@inner
def _scan_row(pose, size, cylinder, bands, cosine, sine, max_range, ranges):
    for k in range(len(pose)):
        if not is_empty(size[k]):
            _scan(pose[k], size[k], cylinder[k], bands, cosine, sine, max_range, ranges)


@inlined
def _scan(pose, size, cylinder, bands, cosine, sine, max_range, ranges):
    """Shorten the ranges of one row, shape (b, beams), that end at a solid."""
    x, y = pose[0], pose[1]
    squared, around = x * x + y * y, squared_radius(size, cylinder)
    if squared >= square(max_range + math.sqrt(around)):
        return
    beams = ranges.shape[1]
    # The beams that pass through the circle around it; rounding may add one at each side.
    first, last = 0, beams - 1
    if squared > around:
        middle, half = math.atan2(y, x) + np.pi, math.asin(math.sqrt(around / squared)) + 1e-9
        per_beam = beams / (2.0 * np.pi)
        first, last = math.ceil((middle - half) * per_beam), math.floor((middle + half) * per_beam)
    turn_x, turn_y = math.cos(pose[2]), math.sin(pose[2])
    u, v = turn_x * x + turn_y * y, turn_x * y - turn_y * x
    for number in range(first, last + 1):
        j = number % beams
        if cylinder:
            reached = _until_circle(x, y, around, cosine[j], sine[j])
        else:
            forward = turn_x * cosine[j] + turn_y * sine[j]
            left = turn_x * sine[j] - turn_y * cosine[j]
            reached = _until_rectangle(u, v, size, forward, left)
        for b in range(len(bands)):
            if size[2] < bands[b, 1] and size[3] > bands[b, 0]:
                ranges[b, j] = min(ranges[b, j], reached)


@inlined
def _until_circle(x, y, squared_radius, cosine, sine):
    """Return the length of a ray from the origin to a circle around (x, y); inf beside it."""
    along, aside = x * cosine + y * sine, y * cosine - x * sine
    if x * x + y * y <= squared_radius:
        return 0.0
    if along <= 0.0 or aside * aside > squared_radius:
        return np.inf
    return along - math.sqrt(squared_radius - aside * aside)


@inlined
def _until_rectangle(x, y, half, cosine, sine):
    """Return the same for an upright rectangle around (x, y)."""
    enter, leave = 0.0, np.inf
    for centre, extent, slope in ((x, half[0], cosine), (y, half[1], sine)):
        if abs(slope) > 1e-12:
            near, far = (centre - extent) / slope, (centre + extent) / slope
            enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
        elif abs(centre) > extent:
            return np.inf
    return enter if enter <= leave else np.inf
