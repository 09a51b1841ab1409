"""Distances from points to the solids of a row, and the cost of a way beside them.

Solids of a row are a table with one line each: x, y, cosine and sine of the yaw, half extents,
lowest and highest z, the radius around it, and whether it is a cylinder; metres.
"""

import math

import numpy as np
from numba import njit

from kinfeas.core import kernel_cache

kernel_cache.settle()  # before the first kernel
kernel = njit(cache=True, error_model="numpy", fastmath=False, nogil=True)

_PENALTY, _DEEPEST = 4.0, 2.0
"""Costs of a way beside solids, as multiples of its length; see `cost_of_metre`."""


@kernel
def table_of(pose, size, cylinder, way):
    """Return the table of the solids of a row, each with the room on its way, shape (k, 2)."""
    table, count = np.empty((len(pose), 10)), 0
    for k in range(len(pose)):
        if size[k, 0] <= 0.0:
            continue
        a, b, x, y = size[k, 0], size[k, 1], 0.5 * way[k, 0], 0.5 * way[k, 1]
        row = table[count]
        row[0], row[1] = pose[k, 0] + x, pose[k, 1] + y
        row[2], row[3] = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        if cylinder[k]:
            a += math.sqrt(x * x + y * y)
        else:
            a, b = a + abs(row[2] * x + row[3] * y), b + abs(row[2] * y - row[3] * x)
        row[4], row[5], row[6], row[7] = a, b, size[k, 2], size[k, 3]
        row[8] = a if cylinder[k] else math.sqrt(a * a + b * b)
        row[9] = 1.0 if cylinder[k] else 0.0
        count += 1
    return table[:count]


@kernel
def horizontal_gap(row, x, y):
    """Return the horizontal distance from a point to a solid, negative inside."""
    dx, dy = x - row[0], y - row[1]
    if row[9] > 0.0:
        return math.sqrt(dx * dx + dy * dy) - row[8]
    along = abs(row[2] * dx + row[3] * dy) - row[4]
    across = abs(row[2] * dy - row[3] * dx) - row[5]
    if along > 0.0 and across > 0.0:
        return math.sqrt(along * along + across * across)
    return max(along, across)


@kernel
def distances(table, x, y, z, limit):
    """Return the distance to the nearest solid and the horizontal one, both at most `limit`."""
    nearest, beside = limit, limit
    for k in range(len(table)):
        row = table[k]
        dx, dy, reach = x - row[0], y - row[1], row[8] + limit
        if dx * dx + dy * dy >= reach * reach:
            continue
        gap = horizontal_gap(row, x, y)
        beside = min(beside, gap)
        above = max(max(row[6] - z, z - row[7]), 0.0)
        gap = max(gap, 0.0)
        nearest = min(nearest, math.sqrt(gap * gap + above * above))
    return nearest, beside


@kernel
def cost_of_metre(beside, clearance):
    """Return the cost of a metre at a horizontal distance: 1 from the preferred clearance on."""
    depth = min(max((clearance - beside) / clearance, 0.0), _DEEPEST)
    return 1.0 + _PENALTY * depth * depth


@kernel
def squared_way(a, b):
    """Return the squared distance of two points, shape (3,) each, m^2."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z
