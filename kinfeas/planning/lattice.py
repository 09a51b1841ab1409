"""A* on lattices: the frontier of a search, and cheapest paths on grids of x, y and height."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.kernels import inner, kernel, square
from kinfeas.core.solid_kernels import PRISM, horizontal_gap, is_empty, vertical_gap, write_prism
from kinfeas.core.spatial import Array

UNSEEN, CLOSED = -1, -2  # values of `Frontier.slot` of nodes that are not open


class Frontier(NamedTuple):
    """Nodes of a search: the open ones are a binary heap by priority, then number."""

    cost: Array  # least cost of each node so far, shape (n,); undefined for unseen nodes
    parent: NDArray[np.int32]  # node before each node on its path, shape (n,), likewise
    priority: Array  # estimated cost of a path through each node, shape (n,), likewise
    slot: NDArray[np.int32]  # index of each node in the heap, shape (n,), or `UNSEEN` or `CLOSED`
    heap: NDArray[np.int32]  # open nodes, shape (n,)
    size: NDArray[np.int32]  # number of open nodes, shape (1,)


@kernel
def make_frontier(nodes):
    """Return the frontier of a search that has not begun."""
    return Frontier(
        np.empty(nodes),
        np.empty(nodes, dtype=np.int32),
        np.empty(nodes),
        np.full(nodes, UNSEEN, dtype=np.int32),
        np.empty(nodes, dtype=np.int32),
        np.zeros(1, dtype=np.int32),
    )


@inner
def improves(frontier, node, cost):
    """Return whether a path to a node that is not closed costs less than all before."""
    slot = frontier.slot[node]
    return slot == UNSEEN or (slot >= 0 and cost < frontier.cost[node])


@inner
def open_node(frontier, node, parent, cost, priority):
    """Open a node with a path through `parent`, or give an open one this cheaper path."""
    heap, slot = frontier.heap, frontier.slot
    i = slot[node]
    if i < 0:
        i = frontier.size[0]
        frontier.size[0] += 1
    frontier.cost[node], frontier.parent[node], frontier.priority[node] = cost, parent, priority
    while i > 0 and _before(frontier, node, heap[(i - 1) // 2]):
        heap[i] = heap[(i - 1) // 2]
        slot[heap[i]] = i
        i = (i - 1) // 2
    heap[i], slot[node] = node, i


@inner
def close_next(frontier):
    """Close the open node of least priority and return it; -1 without any."""
    heap, slot = frontier.heap, frontier.slot
    if frontier.size[0] == 0:
        return -1
    frontier.size[0] -= 1
    first, count, i = heap[0], frontier.size[0], 0
    last = heap[count]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and _before(frontier, heap[child + 1], heap[child]):
            child += 1
        if not _before(frontier, heap[child], last):
            break
        heap[i] = heap[child]
        slot[heap[i]] = i
        i = child
    if count > 0:
        heap[i], slot[last] = last, i
    slot[first] = CLOSED
    return first


@inner
def _before(frontier, node, other):
    a, b = frontier.priority[node], frontier.priority[other]
    return a < b or (a == b and node < other)


@kernel
def path_to(frontier, node):
    """Return the nodes on the path from the first, which is its own parent, to a node, (k,)."""
    count, last = 1, node
    while frontier.parent[node] != node:
        node, count = frontier.parent[node], count + 1
    nodes = np.empty(count, dtype=np.int64)
    for k in range(count - 1, -1, -1):
        nodes[k] = last
        last = frontier.parent[last]
    return nodes


@kernel
def search_grid(free, metre_cost, cell, level, sources, source_costs, goal):
    """Return the frontier after a search from sources to a goal, or everywhere without one.

    Args:
        free: Which nodes can be entered, shape (x, y, heights); their numbers are those of the
            flat array.
        metre_cost: Cost of a metre at each cell, at least 1, shape (x, y).
        cell: Side of a cell, metres.
        level: Distance between heights, metres.
        sources: Nodes at which paths begin, shape (s,).
        source_costs: Costs at which these paths begin, shape (s,), metres.
        goal: Node at which the search ends, or -1.
    """
    nx, ny, nz = free.shape
    frontier = make_frontier(nx * ny * nz)
    gx, gy, gz = goal // (ny * nz), goal // nz % ny, goal % nz
    for s in range(len(sources)):
        if improves(frontier, sources[s], source_costs[s]):
            open_node(frontier, sources[s], sources[s], source_costs[s], source_costs[s])
    while True:
        node = close_next(frontier)
        if node < 0 or node == goal:
            return frontier
        x, y, z = node // (ny * nz), node // nz % ny, node % nz
        for move in range(10 if nz > 1 else 8):
            i, j, h, length = x, y, z, level
            if move < 8:
                step = move if move < 4 else move + 1
                i, j = x + step // 3 - 1, y + step % 3 - 1
                length = cell if i == x or j == y else cell * math.sqrt(2.0)
            else:
                h = z + 2 * (move - 8) - 1
            if i < 0 or j < 0 or h < 0 or i >= nx or j >= ny or h >= nz or not free[i, j, h]:
                continue
            other = (i * ny + j) * nz + h
            cost = frontier.cost[node] + 0.5 * length * (metre_cost[x, y] + metre_cost[i, j])
            if improves(frontier, other, cost):
                ahead = 0.0
                if goal >= 0:
                    dx, dy = abs(i - gx), abs(j - gy)
                    ahead = cell * (max(dx, dy) + (math.sqrt(2.0) - 1.0) * min(dx, dy))
                    ahead += level * abs(h - gz)
                open_node(frontier, other, node, cost, cost + ahead)


@kernel
def make_prisms(pose, size, cylinder):
    """Return the solids of a row as prisms, shape (k, `PRISM`)."""
    prisms, count = np.empty((len(pose), PRISM)), 0
    for k in range(len(pose)):
        if not is_empty(size[k]):
            write_prism(pose[k], size[k], cylinder[k], prisms[count])
            count += 1
    return prisms[:count]


@kernel
def scan_grid(prisms, origin, cell, level, shape, limit, apart):
    """Return the horizontal gap from each cell to prisms, at most `limit`, and the free nodes.

    Gaps have shape (x, y), metres. Free nodes, shape (x, y, heights), are at least `apart` metres
    from all prisms.
    """
    gaps, free = np.full((shape[0], shape[1]), limit), np.ones(shape, dtype=np.bool_)
    reach = max(limit, apart)
    first, last = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    for k in range(len(prisms)):
        prism = prisms[k]
        for i in range(2):
            x, radius = prism[2 + i] - origin[i], prism[9] + reach
            first[i] = max(int((x - radius) / cell), 0)
            last[i] = min(int((x + radius) / cell) + 1, shape[i] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                gap = horizontal_gap(prism, origin[0] + i * cell, origin[1] + j * cell)
                gaps[i, j] = min(gaps[i, j], gap)
                for h in range(shape[2] if gap < apart else 0):
                    above = vertical_gap(prism, origin[2] + h * level)
                    if square(max(gap, 0.0)) + square(above) < square(apart):
                        free[i, j, h] = False
    return gaps, free
