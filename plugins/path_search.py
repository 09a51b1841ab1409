"""Shortest paths of a sphere among upright solids: A* on a grid, and shortcuts.

Kernels work on one motion at a time, so that no row depends on the others. Solids of a row are a
table of `path_geometry`.
"""

import math

import numpy as np

from kinfeas.plugins.path_geometry import (
    POINTS,
    cost_of_metre,
    distances,
    horizontal_gap,
    inner,
    kernel,
    smooth,
    squared_way,
    table_of,
    write_place,
)

_CELL, _MOST_CELLS, _LEVEL = 0.2, 96, 0.3
"""Side of a cell in metres, largest number along an axis, and largest distance of levels."""

_BORDER = 3.0
"""Free space around start and goal that the search covers, metres."""

_MARGIN = 0.05
"""Further distance of corners, metres, which smoothing consumes."""

_HORIZON, _CALM, _GAIN = 3.0, 2.0, 0.9
"""A path is kept if its next metres are free, and cost less than twice their length or nearly as
little as those of a new path."""


@kernel
def replan_batch(planned, share, start, goal, solids, limits, points):
    """Write control points of n paths, shape (n, 64, 3), and whether they are new into `planned`.

    Args:
        planned: Whether the path at hand leads to the goal, shape (n,); then it may be kept.
        share: Share of it that has passed, shape (n,).
        start: Positions now, shape (n, 3).
        goal: Positions at the end, shape (n, 3).
        solids: Pose, size, cylinder and velocity of `Solids`, n rows each.
        limits: Radius of the sphere, preferred clearance, lowest and highest z of detours, metres;
            seconds for which solids take the room that they move into.
        points: Control points at hand; overwritten where the path is new.
    """
    pose, size, cylinder, velocity = solids
    for i in range(len(planned)):
        table = table_of(pose[i], size[i], cylinder[i], velocity[i] * limits[4])
        free, calm, cost = False, False, np.inf
        if planned[i]:
            free, calm, cost = _rest_of(points[i], share[i], table, limits)
        planned[i] = not (free and calm)
        if planned[i]:
            path, new_cost = _path(start[i], goal[i], table, limits)
            planned[i] = not free or new_cost < _GAIN * cost
            if planned[i]:
                smooth(path, table, limits[0], points[i])


@kernel
def _rest_of(points, share, table, limits):
    """Return whether the rest of a path is free, whether it is cheap, and its cost.

    The first two are of the next metres alone.
    """
    free, length, cost, near_cost, near = True, 0.0, 0.0, 0.0, 0.0
    k, at = int(share * (POINTS - 1)) + 1, np.empty(3)
    while k < POINTS:
        step = math.sqrt(squared_way(points[k - 1], points[k]))
        for part in range(2):
            write_place(points, k - 0.5 + 0.5 * part, at)
            nearest, beside = distances(table, at[0], at[1], at[2], limits[1])
            if nearest < limits[0] and length < _HORIZON:
                free = False
            cost += 0.5 * step * cost_of_metre(beside, limits[1])
        length += step
        if length < _HORIZON:
            near_cost, near = cost, length
        k += 1
    return free, near_cost <= _CALM * near, cost


@kernel
def _path(start, goal, table, limits):
    """Return the corners of the cheapest path, shape (m, 3), and its cost.

    It is the straight line if this is clear of all solids, or if there is no path.
    """
    straight = np.empty((2, 3))
    straight[0], straight[1] = start, goal
    origin, cell, levels = _grid(start, goal, limits)
    shape = levels[3:].astype(np.int64)
    free, multiple = _fields(table, origin, cell, levels[2], shape, limits)
    length = math.sqrt(squared_way(start, goal))
    direct = _segment(start, goal, table, origin, cell, multiple, limits, np.inf)
    if direct <= length * 1.02 + 1e-9:
        return straight, direct
    # Backwards, since goals are walled in more often than starts.
    nodes = np.empty(2, dtype=np.int64)
    for end in range(2):
        nodes[end] = _nearest_free(straight[end], free, origin, cell, levels[2], table, limits)
        if nodes[end] < 0:
            return straight, direct
    parent = _search(nodes[1], nodes[0], free, multiple, cell, levels[2])
    if parent[nodes[0]] < 0:
        return straight, direct
    count, node = 1, nodes[0]
    while node != nodes[1]:
        node = parent[node]
        count += 1
    corners = np.empty((count + 2, 3))
    node = nodes[0]
    for i in range(1, count + 1):
        x, rest = node // (shape[1] * shape[2]), node % (shape[1] * shape[2])
        corners[i, 0] = origin[0] + x * cell
        corners[i, 1] = origin[1] + (rest // shape[2]) * cell
        corners[i, 2] = origin[2] + (rest % shape[2]) * levels[2]
        node = parent[node]
    corners[0], corners[-1] = start, goal
    for _ in range(2):
        corners = _shortcut(_divided(corners), table, origin, cell, multiple, limits)
    cost = 0.0
    for i in range(1, len(corners)):
        a, b = corners[i - 1], corners[i]
        cost += _segment(a, b, table, origin, cell, multiple, limits, -1.0)
    return corners, cost


@kernel
def _grid(start, goal, limits):
    """Return the origin, the side of a cell, and levels: two zeros, their distance, the counts."""
    origin, levels = np.empty(3), np.zeros(6)
    for i in range(2):
        origin[i] = min(start[i], goal[i]) - _BORDER
    side = max(abs(start[0] - goal[0]), abs(start[1] - goal[1])) + 2.0 * _BORDER
    cell = max(_CELL, side / (_MOST_CELLS - 2))
    for i in range(2):
        levels[3 + i] = int((abs(start[i] - goal[i]) + 2.0 * _BORDER) / cell) + 2
    origin[2] = min(min(start[2], goal[2]), limits[2])
    height = max(max(start[2], goal[2]), limits[3]) - origin[2]
    levels[5] = min(max(int(height / _LEVEL) + 2, 2), 12)
    levels[2] = max(height / (levels[5] - 1), 1e-3)
    return origin, cell, levels


@kernel
def _fields(table, origin, cell, level, shape, limits):
    """Return which nodes are free, (x, y, z), and the cost of a metre at each cell, (x, y)."""
    radius, clearance = limits[0], limits[1]
    half = 0.5 * max(cell * math.sqrt(2.0), level)
    # The ways between free nodes are free, too.
    apart = max(math.sqrt(radius * radius + half * half), radius + _MARGIN)
    beside = np.full((shape[0], shape[1]), clearance)
    free = np.ones((shape[0], shape[1], shape[2]), dtype=np.bool_)
    for k in range(len(table)):
        row = table[k]
        reach = row[8] + max(clearance, apart)
        first, last = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
        for i in range(2):
            first[i] = max(int((row[i] - reach - origin[i]) / cell), 0)
            last[i] = min(int((row[i] + reach - origin[i]) / cell) + 1, shape[i] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                gap = horizontal_gap(row, origin[0] + i * cell, origin[1] + j * cell)
                beside[i, j] = min(beside[i, j], gap)
                if gap >= apart:
                    continue
                gap = max(gap, 0.0)
                for h in range(shape[2]):
                    z = origin[2] + h * level
                    above = max(max(row[6] - z, z - row[7]), 0.0)
                    if gap * gap + above * above < apart * apart:
                        free[i, j, h] = False
    for i in range(shape[0]):
        for j in range(shape[1]):
            beside[i, j] = cost_of_metre(beside[i, j], clearance)
    return free, beside


@inner
def _segment(a, b, table, origin, cell, multiple, limits, bound):
    """Return the cost of a straight piece; infinite if it is not free or more than `bound`.

    With a negative bound, solids are ignored.
    """
    length = math.sqrt(squared_way(a, b))
    pieces = max(int(length / (0.5 * cell)) + 1, 2)
    # Where a metre costs less than this, no solid is nearer than the radius.
    apart = limits[0] + _MARGIN
    safe = cost_of_metre(apart + cell, limits[1])
    cost, step = 0.0, length / pieces
    for k in range(pieces + 1):
        share = k / pieces
        x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
        i = min(max(int((x - origin[0]) / cell + 0.5), 0), multiple.shape[0] - 1)
        j = min(max(int((y - origin[1]) / cell + 0.5), 0), multiple.shape[1] - 1)
        here = multiple[i, j]
        cost += (0.5 if k in (0, pieces) else 1.0) * step * here
        if bound < 0.0:
            continue
        if cost > bound:
            return np.inf
        if here > safe or safe <= 1.0:
            z = a[2] + share * (b[2] - a[2])
            if distances(table, x, y, z, apart)[0] < apart:
                return np.inf
    return cost


@kernel
def _nearest_free(point, free, origin, cell, level, table, limits):
    """Return the number of the nearest free node, preferably one in sight; -1 without any."""
    best, number = np.inf, -1
    at, to = np.empty(3, dtype=np.int64), np.empty(3)
    for i in range(3):
        at[i] = int((point[i] - origin[i]) / (cell if i < 2 else level) + 0.5)
    for i in range(max(at[0] - 6, 0), min(at[0] + 7, free.shape[0])):
        for j in range(max(at[1] - 6, 0), min(at[1] + 7, free.shape[1])):
            for h in range(free.shape[2]):
                if not free[i, j, h]:
                    continue
                to[0], to[1] = origin[0] + i * cell, origin[1] + j * cell
                to[2] = origin[2] + h * level
                far = math.sqrt(squared_way(point, to))
                if far >= best:
                    continue
                for k in range(1, 5):
                    at_share = point + 0.2 * k * (to - point)
                    if (
                        distances(table, at_share[0], at_share[1], at_share[2], limits[0])[0]
                        < (limits[0])
                    ):
                        far += 1.0
                if far < best:
                    best, number = far, (i * free.shape[1] + j) * free.shape[2] + h
    return number


@kernel
def _search(first, last, free, multiple, cell, level):
    """Return the node before each one on its cheapest path from the first; -1 if not visited."""
    nx, ny, nz = free.shape
    total = nx * ny * nz
    cost, parent = np.full(total, np.inf), np.full(total, -1, dtype=np.int64)
    done = np.zeros(total, dtype=np.bool_)
    keys, nodes, count = np.empty(4 * total), np.empty(4 * total, dtype=np.int64), 0
    gx, gy, gz = last // (ny * nz), last // nz % ny, last % nz
    cost[first], parent[first] = 0.0, first
    count = _push(keys, nodes, count, 0.0, first)
    while count > 0:
        node = nodes[0]
        count = _pop(keys, nodes, count)
        if done[node]:
            continue
        done[node] = True
        if node == last:
            break
        x, y, z = node // (ny * nz), node // nz % ny, node % nz
        for way in range(10):
            i, j, h = x, y, z
            if way < 8:
                way_index = way if way < 4 else way + 1
                i, j = x + way_index // 3 - 1, y + way_index % 3 - 1
            else:
                h = z + 2 * (way - 8) - 1
            if i < 0 or j < 0 or h < 0 or i >= nx or j >= ny or h >= nz or not free[i, j, h]:
                continue
            other = (i * ny + j) * nz + h
            if done[other]:
                continue
            length = level
            if way < 8:
                length = cell if i == x or j == y else cell * math.sqrt(2.0)
            new = cost[node] + 0.5 * length * (multiple[x, y] + multiple[i, j])
            if new < cost[other] and count < len(keys):
                cost[other], parent[other] = new, node
                dx, dy = abs(i - gx), abs(j - gy)
                flat = cell * (max(dx, dy) + (math.sqrt(2.0) - 1.0) * min(dx, dy))
                left = flat + level * abs(h - gz)
                count = _push(keys, nodes, count, new + left, other)
    return parent


@inner
def _push(keys, nodes, count, key, node):
    """Add an entry to a binary heap; return its size."""
    i = count
    while i > 0 and keys[(i - 1) // 2] > key:
        keys[i], nodes[i] = keys[(i - 1) // 2], nodes[(i - 1) // 2]
        i = (i - 1) // 2
    keys[i], nodes[i] = key, node
    return count + 1


@inner
def _pop(keys, nodes, count):
    """Remove the smallest entry of a binary heap; return its size."""
    count -= 1
    key, node, i = keys[count], nodes[count], 0
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i], nodes[i] = keys[child], nodes[child]
        i = child
    keys[i], nodes[i] = key, node
    return count


@kernel
def _divided(corners):
    """Return the corners of a path without those on straight lines, and points between them."""
    kept = [0]
    for i in range(1, len(corners) - 1):
        a, b, c = corners[kept[-1]], corners[i], corners[i + 1]
        along, across = b - a, c - b
        x = along[1] * across[2] - along[2] * across[1]
        y = along[2] * across[0] - along[0] * across[2]
        z = along[0] * across[1] - along[1] * across[0]
        if x * x + y * y + z * z > 1e-12:
            kept.append(i)
    kept.append(len(corners) - 1)
    points = np.empty((2 * len(kept) - 1, 3))
    for i in range(len(kept)):
        points[2 * i] = corners[kept[i]]
        if i > 0:
            points[2 * i - 1] = 0.5 * (corners[kept[i - 1]] + corners[kept[i]])
    return points


@kernel
def _shortcut(points, table, origin, cell, multiple, limits):
    """Return those corners of the cheapest path along some of the points, in order."""
    count = len(points)
    best, before = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    best[0] = 0.0
    for j in range(1, count):
        # Neighbours are joined even where the radius is not kept.
        best[j] = best[j - 1] + _segment(
            points[j - 1], points[j], table, origin, cell, multiple, limits, -1.0
        )
        before[j] = j - 1
        for i in range(j - 1):
            bound = best[j] - best[i]
            if math.sqrt(squared_way(points[i], points[j])) >= bound:
                continue
            cost = _segment(points[i], points[j], table, origin, cell, multiple, limits, bound)
            if cost < bound:
                best[j], before[j] = best[i] + cost, i
    kept, j = 1, count - 1
    while j > 0:
        kept, j = kept + 1, before[j]
    corners, j = np.empty((kept, 3)), count - 1
    for k in range(kept - 1, -1, -1):
        corners[k] = points[j]
        j = before[j]
    return corners
