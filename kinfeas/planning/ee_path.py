"""EE paths among solids: A* of a sphere on a grid of x, y and height, shortcuts, rounded corners.

Kernels work on one motion at a time, so that no row depends on the others. Solids of a row are
prisms of `solid_kernels`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import inner, kernel
from kinfeas.core.solid_kernels import horizontal_gap, vertical_gap
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.planning.lattice import UNSEEN, make_prisms, path_to, scan_grid, search_grid
from kinfeas.planning.spline import POINTS, squared_length, write_position


class EePathSettings(NamedTuple):
    """Settings of the search for EE paths."""

    radius: float  # of the sphere around the EE that stays free of solids, metres
    clearance: float  # preferred horizontal distance of the EE from solids, metres
    min_height: float  # lowest z of a detour, unless start or goal are lower, metres
    max_height: float  # highest z of a detour, likewise, metres
    foresight: float  # moving solids occupy all the room that they pass within this time, s
    margin: float = 0.05  # distance that corners keep beyond the radius, for smoothing, metres
    penalty: float = 4.0  # additional cost of a metre at a distance of 0; 0 at the clearance
    deepest: float = 2.0  # depth within the clearance, in clearances, beyond which cost is constant
    cell: float = 0.2  # least side of a cell, metres
    most_cells: int = 96  # largest number of cells along an axis
    level: float = 0.3  # largest distance between heights of the grid, metres
    most_levels: int = 12  # largest number of heights
    border: float = 3.0  # free space around start and goal that the search covers, metres
    horizon: float = 3.0  # part of a path that must be free and cheap to be kept, metres
    cheap: float = 2.0  # largest mean cost of a metre of this part
    gain: float = 0.9  # fraction of the cost below which a new path replaces one that is not cheap
    window: float = 0.35  # length of the moving average that rounds corners, metres


def plan_ee_paths(
    settings: EePathSettings,
    current: tuple[NDArray[np.bool_], Array, Array],
    start: Array,
    goal: Array,
    solids: Solids,
) -> tuple[NDArray[np.bool_], Array]:
    """Return which of n EE paths are new, shape (n,), and control points, shape (n, 64, 3).

    Args:
        settings: Settings of the search.
        current: Whether current paths lead to the goals, shape (n,), the fractions of them that are
            done, shape (n,), and their control points, shape (n, 64, 3), world, metres.
        start: World positions of the EE now, shape (n, 3), metres.
        goal: World positions of the EE at the end, shape (n, 3), metres.
        solids: In the world as they are now, n rows.
    """
    swept = solids.swept(0.0, settings.foresight)
    rows = tuple(map(np.ascontiguousarray, (swept.pose, swept.size, swept.cylinder)))
    new, points = current[0].copy(), current[2].copy()
    ends = np.ascontiguousarray(start), np.ascontiguousarray(goal)
    _replan_batch(settings, new, current[1], *ends, rows, points)
    return new, points


@kernel
def _replan_batch(settings, new, fraction, start, goal, solids, points):
    """Write new paths; `new` has which paths lead to the goals and receives which are new."""
    pose, size, cylinder = solids
    for i in range(len(new)):
        prisms = make_prisms(pose[i], size[i], cylinder[i])
        free, cheap, cost = False, False, np.inf
        if new[i]:
            free, cheap, cost = _assess(points[i], fraction[i], prisms, settings)
        new[i] = not (free and cheap)
        if new[i]:
            path, new_cost = _cheapest_path(start[i], goal[i], prisms, settings)
            new[i] = not free or new_cost < settings.gain * cost
            if new[i]:
                _smooth(path, prisms, settings, points[i])


@inner
def _distances(prisms, x, y, z, limit):
    """Return the least distance and the least horizontal distance to solids, at most `limit`."""
    nearest, beside = limit, limit
    for k in range(len(prisms)):
        prism = prisms[k]
        dx, dy, reach = x - prism[2], y - prism[3], prism[9] + limit
        if dx * dx + dy * dy >= reach * reach:
            continue
        gap = horizontal_gap(prism, x, y)
        beside = min(beside, gap)
        gap, above = max(gap, 0.0), vertical_gap(prism, z)
        nearest = min(nearest, math.sqrt(gap * gap + above * above))
    return nearest, beside


@inner
def _cost_of_metre(beside, settings):
    """Return the cost of a metre at a horizontal distance: 1 from the preferred clearance on."""
    depth = max((settings.clearance - beside) / settings.clearance, 0.0)
    depth = min(depth, settings.deepest)
    return 1.0 + settings.penalty * depth * depth


@kernel
def _assess(points, fraction, prisms, settings):
    """Return whether a path is free and whether it is cheap on the next metres, and its cost.

    The cost is that of the whole rest of the path; the next metres are those of `horizon`.
    """
    free, length, cost, near_cost, near = True, 0.0, 0.0, 0.0, 0.0
    k, position = int(fraction * (POINTS - 1)) + 1, np.empty(3)
    while k < POINTS:
        step = math.sqrt(squared_length(points[k - 1], points[k]))
        for part in range(2):
            write_position(points, k - 0.5 + 0.5 * part, position)
            farthest = max(settings.clearance, settings.radius)
            nearest, beside = _distances(prisms, position[0], position[1], position[2], farthest)
            if nearest < settings.radius and length < settings.horizon:
                free = False
            cost += 0.5 * step * _cost_of_metre(beside, settings)
        length += step
        if length < settings.horizon:
            near_cost, near = cost, length
        k += 1
    return free, near_cost <= settings.cheap * near, cost


class _Grid(NamedTuple):
    """Grid of x, y and height around a motion."""

    prisms: Array  # the solids, shape (k, `PRISM`)
    origin: Array  # position of the first node, shape (3,), metres
    cell: float  # side of a cell, metres
    level: float  # distance between heights, metres
    free: NDArray[np.bool_]  # which nodes are free, shape (x, y, heights)
    cost: Array  # cost of a metre at each cell, shape (x, y)


@kernel
def _cheapest_path(start, goal, prisms, settings):
    """Return the corners of the cheapest path, shape (m, 3), and its cost.

    It is the straight line if this is clear of all solids, or if there is no path.
    """
    straight = np.empty((2, 3))
    straight[0], straight[1] = start, goal
    grid = _make_grid(start, goal, prisms, settings)
    length = math.sqrt(squared_length(start, goal))
    direct = _segment(start, goal, grid, settings, np.inf)
    if direct <= length * 1.02 + 1e-9:
        return straight, direct
    # Backwards, since goals are walled in more often than starts.
    last, first = _nearest_free(start, grid, settings), _nearest_free(goal, grid, settings)
    if first < 0 or last < 0:
        return straight, direct
    sources = np.array([first])
    frontier = search_grid(grid.free, grid.cost, grid.cell, grid.level, sources, np.zeros(1), last)
    if frontier.slot[last] == UNSEEN:
        return straight, direct
    nodes = path_to(frontier, last)
    corners = np.empty((len(nodes) + 2, 3))
    for i in range(len(nodes)):
        _write_node(nodes[-1 - i], grid, corners[i + 1])
    corners[0], corners[-1] = start, goal
    for _ in range(2):
        corners = _shortcut(_divided(corners), grid, settings)
    cost = 0.0
    for i in range(1, len(corners)):
        cost += _segment(corners[i - 1], corners[i], grid, settings, -1.0)
    return corners, cost


@kernel
def _make_grid(start, goal, prisms, settings):
    origin = np.minimum(start, goal) - settings.border
    width, depth = np.abs(start[:2] - goal[:2]) + 2.0 * settings.border
    cell = max(settings.cell, max(width, depth) / (settings.most_cells - 2))
    nx, ny = int(width / cell) + 2, int(depth / cell) + 2
    origin[2] = min(min(start[2], goal[2]), settings.min_height)
    height = max(max(start[2], goal[2]), settings.max_height) - origin[2]
    nz = min(max(int(height / settings.level) + 2, 2), settings.most_levels)
    level = max(height / (nz - 1), 1e-3)
    radius, clearance = settings.radius, settings.clearance
    half = 0.5 * max(cell * math.sqrt(2.0), level)
    # Lines between free nodes are free, too.
    apart = max(math.sqrt(radius * radius + half * half), radius + settings.margin)
    cost, free = scan_grid(prisms, origin, cell, level, (nx, ny, nz), clearance, apart)
    for i in range(nx):
        for j in range(ny):
            cost[i, j] = _cost_of_metre(cost[i, j], settings)
    return _Grid(prisms, origin, cell, level, free, cost)


@inner
def _write_node(node, grid, out):
    _, ny, nz = grid.free.shape
    out[0] = grid.origin[0] + node // (ny * nz) * grid.cell
    out[1] = grid.origin[1] + node // nz % ny * grid.cell
    out[2] = grid.origin[2] + node % nz * grid.level


@inner
def _segment(a, b, grid, settings, bound):
    """Return the cost of a straight piece; infinite if it is not free or costs more than `bound`.

    With a negative bound, solids are ignored.
    """
    cell, origin, (nx, ny) = grid.cell, grid.origin, grid.cost.shape
    length = math.sqrt(squared_length(a, b))
    pieces = max(int(length / (0.5 * cell)) + 1, 2)
    # Where a metre costs less than `safe`, no solid is nearer than `apart`.
    apart = settings.radius + settings.margin
    safe = _cost_of_metre(apart + cell, settings)
    cost, step = 0.0, length / pieces
    for k in range(pieces + 1):
        fraction = k / pieces
        x, y = a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])
        i = min(max(int((x - origin[0]) / cell + 0.5), 0), nx - 1)
        j = min(max(int((y - origin[1]) / cell + 0.5), 0), ny - 1)
        here = grid.cost[i, j]
        cost += (0.5 if k in (0, pieces) else 1.0) * step * here
        if bound < 0.0:
            continue
        if cost > bound:
            return np.inf
        if here > safe or safe <= 1.0:
            z = a[2] + fraction * (b[2] - a[2])
            if _distances(grid.prisms, x, y, z, apart)[0] < apart:
                return np.inf
    return cost


@kernel
def _nearest_free(point, grid, settings):
    """Return the index of the nearest free node, preferably one in sight, or -1."""
    best, number, radius = np.inf, -1, settings.radius
    near, node = np.empty(2, dtype=np.int64), np.empty(3)
    for i in range(2):
        near[i] = int((point[i] - grid.origin[i]) / grid.cell + 0.5)
    nx, ny, nz = grid.free.shape
    for i in range(max(near[0] - 6, 0), min(near[0] + 7, nx)):
        for j in range(max(near[1] - 6, 0), min(near[1] + 7, ny)):
            for h in range(nz):
                if not grid.free[i, j, h]:
                    continue
                node[0], node[1] = grid.origin[0] + i * grid.cell, grid.origin[1] + j * grid.cell
                node[2] = grid.origin[2] + h * grid.level
                cost = math.sqrt(squared_length(point, node))
                if cost >= best:
                    continue
                for k in range(1, 5):
                    x, y, z = point + 0.2 * k * (node - point)
                    if _distances(grid.prisms, x, y, z, radius)[0] < radius:
                        cost += 1.0
                if cost < best:
                    best, number = cost, (i * ny + j) * nz + h
    return number


@kernel
def _divided(corners):
    """Return the corners at which a path bends, its ends, and the midpoints between them."""
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
def _shortcut(points, grid, settings):
    """Return the points that the cheapest path through some of them visits, in order."""
    count = len(points)
    best, before = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    best[0] = 0.0
    for j in range(1, count):
        # Neighbours are joined even where the radius is not kept.
        best[j] = best[j - 1] + _segment(points[j - 1], points[j], grid, settings, -1.0)
        before[j] = j - 1
        for i in range(j - 1):
            bound = best[j] - best[i]
            if math.sqrt(squared_length(points[i], points[j])) >= bound:
                continue
            cost = _segment(points[i], points[j], grid, settings, bound)
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


@kernel
def _smooth(corners, prisms, settings, points):
    """Write a path with rounded corners as control points at even steps, shape (64, 3).

    Each point is the mean of the path around it, over a length that is halved until the radius
    around the path is as free as around the corners.
    """
    count = len(corners)
    length, integral = np.zeros(count), np.zeros((count, 3))
    for i in range(1, count):
        step = math.sqrt(squared_length(corners[i - 1], corners[i]))
        length[i] = length[i - 1] + step
        integral[i] = integral[i - 1] + 0.5 * step * (corners[i - 1] + corners[i])
    window, sharp, total = settings.window, np.empty((POINTS, 3)), length[-1]
    for i in range(POINTS):
        sharp[i] = _at(corners, length, integral, total * i / (POINTS - 1))[:3]
    while True:
        for i in range(POINTS):
            s = total * i / (POINTS - 1)
            half = 0.5 * min(window, 2.0 * min(s, total - s))
            points[i] = sharp[i]
            if half > 1e-6:
                low = _at(corners, length, integral, s - half)[3:]
                high = _at(corners, length, integral, s + half)[3:]
                points[i] = (high - low) / (2.0 * half)
        points[0], points[-1] = corners[0], corners[-1]
        if window < 0.02 or not _worse(points, sharp, prisms, settings.radius):
            return
        window *= 0.5


@kernel
def _at(corners, length, integral, s):
    """Return the position after `s` metres of a path and its integral until there, shape (6,)."""
    k = 1
    while k < len(length) - 1 and length[k] < s:
        k += 1
    done = min(max(s - length[k - 1], 0.0), length[k] - length[k - 1])
    fraction = done / max(length[k] - length[k - 1], 1e-12)
    both = np.empty(6)
    for i in range(3):
        both[i] = corners[k - 1, i] + fraction * (corners[k, i] - corners[k - 1, i])
        both[3 + i] = integral[k - 1, i] + 0.5 * done * (corners[k - 1, i] + both[i])
    return both


@kernel
def _worse(points, sharp, prisms, radius):
    """Return whether a path comes nearer to solids than the radius where `sharp` does not."""
    a, b = np.empty(3), np.empty(3)
    for i in range(2 * POINTS - 1):
        write_position(points, 0.5 * i, a)
        write_position(sharp, 0.5 * i, b)
        near = _distances(prisms, a[0], a[1], a[2], radius)[0] < radius
        if near and _distances(prisms, b[0], b[1], b[2], radius)[0] >= radius:
            return True
    return False
