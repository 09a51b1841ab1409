"""Shortest base paths among solids: A* on a lattice of x, y and heading."""

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from kinfeas.kinematics.base_obstacles import outward, write_prism
from kinfeas.kinematics.kernels import inner, kernel, square
from kinfeas.kinematics.self_collision import make_collision_scratch, place_shapes
from kinfeas.kinematics.solids import bounds, is_empty, squared_radius, touches_solids

CELL, HEADINGS = 0.125, 16
"""Side of a cell of the lattice, metres, and its headings in a full turn."""

_TURN = 2.0 * math.pi / HEADINGS

LEVER = 1.0
"""Metres of driving that take as long as a radian of turning."""

_CLEARANCE, _CROWDED = 0.6, 6.0
"""Distance that the base prefers to keep from solids, metres, and what a metre beside one costs
more."""

_SIDEWAYS = 1.0
"""What a metre sideways costs more than one ahead; a metre back costs twice that."""

FORESIGHT = 10.0
"""Seconds for which solids are assumed to move on."""

_GREED = 1.3
"""Factor of the estimated cost ahead: paths may be longer by this, and are found sooner."""


def lattice_moves(*, omnidirectional: bool) -> NDArray[np.int64]:
    """Return the moves from each heading, shape (headings, m, 4).

    Each has steps of x, y and heading, and a cost in millimetres.
    """
    moves = []
    for heading in range(HEADINGS):
        angle = _TURN * heading
        each = [(0, 0, side) for side in (-1, 1)]
        if omnidirectional:
            around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
            each += [(i, j, side) for i, j in around for side in (-1, 0, 1)]
        else:
            length = 2.2 if heading % 2 else 1.4  # to a corner, or as in a knight's move
            i, j = (round(length * f(angle)) for f in (np.cos, np.sin))
            each += [(i, j, side) for side in (-1, 0, 1)] + [(-i, -j, 0)]
        costs = []
        for i, j, side in each:
            aside = 1.0 - math.cos(math.atan2(j, i) - angle) if i or j else 0.0
            way = CELL * math.hypot(i, j) * (1.0 + _SIDEWAYS * aside)
            costs.append(round(1000 * max(way, LEVER * _TURN * abs(side))))
        moves.append([(*one, cost) for one, cost in zip(each, costs, strict=True)])
    return np.array(moves)


@kernel
def driving_costs(origin, shape, solids, disc):
    """Return what a metre of driving costs at each cell, shape (x, y).

    Args:
        origin: Position of the first cell, shape (2,), metres.
        shape: Number of cells along x and y.
        solids: Pose, size, cylinder and velocity of one row of `Solids`; those that move have no
            cost.
        disc: Radius and height of a disc within the base, metres; where it touches a solid, the
            cost is infinite.
    """
    pose, size, cylinder, velocity = solids
    want, prism = disc[0] + _CLEARANCE, np.zeros(9)
    cost = np.full((shape[0], shape[1]), want)  # first the distance from solids
    for k in range(len(pose)):
        moves = velocity[k, 0] != 0.0 or velocity[k, 1] != 0.0
        if is_empty(size[k]) or size[k, 2] > disc[1] or moves:
            continue
        write_prism(pose[k], size[k], cylinder[k], prism)
        reach = math.sqrt(squared_radius(size[k], cylinder[k])) + want
        first, last = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
        for i in range(2):
            first[i] = max(int((pose[k, i] - reach - origin[i]) / CELL), 0)
            last[i] = min(int((pose[k, i] + reach - origin[i]) / CELL) + 1, shape[i] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                gap, _, _ = outward(origin[0] + CELL * i, origin[1] + CELL * j, prism)
                cost[i, j] = min(cost[i, j], gap - prism[6])
    for i in range(shape[0]):
        for j in range(shape[1]):
            near = 1.0 - cost[i, j] / want
            cost[i, j] = np.inf if cost[i, j] < disc[0] else 1.0 + _CROWDED * near * near
    return cost


@kernel
def search_base(model, rest, reach, start, places, place_cost, solids, grid, moves, speed):
    """Return base poses on the cheapest way to a place, shape (k, 3), and its number, or -1.

    Solids that move are where they will be when the base comes by.

    Args:
        model: Shapes of the robot.
        rest: Arm joints on the way, shape (j,).
        reach: Distance from start and places within which the arm is not at rest, metres.
        start: x, y and yaw of the base, shape (3,).
        places: The same where it may arrive, shape (p, 3).
        place_cost: What it costs to arrive there, shape (p,), metres.
        solids: Pose, size, cylinder and velocity of one row of `Solids`.
        grid: Position of the first cell, and `driving_costs`.
        moves: From `lattice_moves`.
        speed: Of the base, m/s and rad/s.
    """
    origin, cost = grid
    pose, _, _, velocity = solids
    moving = np.any(velocity != 0.0)
    nx, ny = cost.shape
    total, first = nx * ny * HEADINGS, _node(start, origin, ny)
    ahead = _costs_ahead(places, place_cost, origin, cost)
    # 0 is unseen, and only then the other arrays have no values; 1 seen, 2 blocked or done.
    state = np.zeros(total, dtype=np.int8)
    best, seconds, parent = np.empty(total), np.empty(total), np.empty(total, dtype=np.int64)
    arrival = np.full(total, -1, dtype=np.int16)
    for p in range(len(places)):
        node = _node(places[p], origin, ny)
        if arrival[node] < 0 or place_cost[p] < place_cost[arrival[node]]:
            arrival[node], state[node], best[node] = p, 1, np.inf
    scratch = make_collision_scratch(model)
    place_shapes(model, rest, scratch)
    near = np.concatenate((start[np.newaxis], places)), square(reach)
    around = bounds(model, False, scratch), bounds(model, True, scratch)
    best[first], seconds[first], parent[first], state[first] = 0.0, 0.0, first, 1
    queue = [(0.0, first)]
    if ahead[first // HEADINGS // ny, first // HEADINGS % ny] == np.inf:
        queue.clear()
    base, local = np.empty(3), np.empty_like(pose)
    while len(queue) > 0:
        _, node = heapq.heappop(queue)
        if node >= total:  # an arrival, at its whole cost
            return _way_to(node - total, parent, origin, ny), arrival[node - total]
        if state[node] == 2:
            continue
        state[node] = 2
        heading, x, y = node % HEADINGS, node // HEADINGS // ny, node // HEADINGS % ny
        if arrival[node] >= 0:
            heapq.heappush(queue, (best[node] + place_cost[arrival[node]], total + node))
        elif node != first and not moving:  # not before, since most are seen and never come to
            _write_place(x, y, heading, origin, base)
            if _touches(model, around, base, near, solids, 0.0, local, scratch):
                continue
        here = min(cost[x, y], 1.0 + _CROWDED)
        for m in range(moves.shape[1]):
            step_x, step_y = moves[heading, m, 0], moves[heading, m, 1]
            i, j = x + step_x, y + step_y
            if i < 0 or j < 0 or i >= nx or j >= ny or ahead[i, j] == np.inf:
                continue
            turned = (heading + moves[heading, m, 2]) % HEADINGS
            other = (i * ny + j) * HEADINGS + turned
            if state[other] == 2:
                continue
            metre = here + min(cost[i, j], 1.0 + _CROWDED)
            new = best[node] + 0.0005 * moves[heading, m, 3] * metre
            if state[other] == 0:
                state[other], best[other] = 1, np.inf
            if new >= best[other]:
                continue
            if moving:  # solids may have left when the base comes by another way
                way, turn = CELL * math.hypot(step_x, step_y), _TURN * abs(moves[heading, m, 2])
                time = seconds[node] + max(way / speed[0], turn / speed[1])
                _write_place(i, j, turned, origin, base)
                then = min(time, FORESIGHT)
                if _touches(model, around, base, near, solids, then, local, scratch):
                    continue
                seconds[other] = time
            best[other], parent[other] = new, node
            heapq.heappush(queue, (new + _GREED * ahead[i, j], other))
    return np.empty((0, 3)), -1


@kernel
def _costs_ahead(places, place_cost, origin, cost):
    """Return the least costs of driving from each cell to a place without turning, (x, y)."""
    nx, ny = cost.shape
    ahead, done = np.full((nx, ny), np.inf), np.zeros((nx, ny), dtype=np.bool_)
    queue = [(0.0, 0)]
    queue.clear()
    for p in range(len(places)):
        cell = _node(places[p], origin, ny) // HEADINGS
        ahead[cell // ny, cell % ny] = min(ahead[cell // ny, cell % ny], place_cost[p])
        heapq.heappush(queue, (place_cost[p], cell))
    while len(queue) > 0:
        _, cell = heapq.heappop(queue)
        x, y = cell // ny, cell % ny
        if done[x, y]:
            continue
        done[x, y] = True
        for way in range(9):
            i, j = x + way // 3 - 1, y + way % 3 - 1
            if i < 0 or j < 0 or i >= nx or j >= ny or done[i, j] or cost[i, j] == np.inf:
                continue
            length = CELL if i == x or j == y else math.sqrt(2.0) * CELL
            here = min(cost[x, y], 1.0 + _CROWDED)  # places may be in cells that are blocked
            new = ahead[x, y] + 0.5 * length * (here + cost[i, j])
            if new < ahead[i, j]:
                ahead[i, j] = new
                heapq.heappush(queue, (new, i * ny + j))
    return ahead


@inner
def _node(place, origin, ny):
    """Return the number of the node nearest to a place."""
    x = int((place[0] - origin[0]) / CELL + 0.5)
    y = int((place[1] - origin[1]) / CELL + 0.5)
    heading = math.floor(place[2] / _TURN + 0.5) % HEADINGS
    return (x * ny + y) * HEADINGS + heading


@inner
def _touches(model, around, base, near, solids, seconds, local, scratch):
    """Return whether the robot at a base pose, shape (3,), touches solids after some seconds.

    `around` are the `bounds` of the shapes on the base and on the arm. The arm counts only beyond a
    squared distance from the places in `near`, (p, 3). `local` and `scratch` are memory.
    """
    pose, size, cylinder, velocity = solids
    cosine, sine = math.cos(base[2]), math.sin(base[2])
    for k in range(len(pose)):
        dx = pose[k, 0] + velocity[k, 0] * seconds - base[0]
        dy = pose[k, 1] + velocity[k, 1] * seconds - base[1]
        local[k, 0], local[k, 1] = cosine * dx + sine * dy, cosine * dy - sine * dx
        local[k, 2] = pose[k, 2] - base[2]
    if touches_solids(model, False, around[0], local, size, cylinder, scratch):
        return True
    places, squared = near
    for p in range(len(places)):
        if square(base[0] - places[p, 0]) + square(base[1] - places[p, 1]) <= squared:
            return False
    return touches_solids(model, True, around[1], local, size, cylinder, scratch)


@inner
def _write_place(x, y, heading, origin, out):
    """Write the base pose of a node, shape (3,)."""
    out[0], out[1], out[2] = origin[0] + CELL * x, origin[1] + CELL * y, _TURN * heading


@kernel
def _way_to(last, parent, origin, ny):
    """Return the base poses from the first node, which is its own parent, to the last, (k, 3)."""
    count, node = 1, last
    while parent[node] != node:
        node, count = parent[node], count + 1
    path, node = np.empty((count, 3)), last
    for k in range(count - 1, -1, -1):
        x, y = node // HEADINGS // ny, node // HEADINGS % ny
        _write_place(x, y, node % HEADINGS, origin, path[k])
        node = parent[node]
    return path
