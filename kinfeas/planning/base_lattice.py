"""Cheapest base paths among solids: A* on a lattice of x, y and heading."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.kernels import inlined, inner, kernel, square
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.self_collision import (
    CollisionModel,
    CollisionScratch,
    make_collision_scratch,
    place_shapes,
)
from kinfeas.kinematics.solids import bounds, touches_solids
from kinfeas.planning.lattice import (
    UNSEEN,
    Frontier,
    close_next,
    improves,
    make_frontier,
    make_prisms,
    open_node,
    path_to,
    scan_grid,
    search_grid,
)


class BaseLattice(NamedTuple):
    """Settings of the lattice and of the costs of driving on it."""

    cell: float = 0.125  # side of a cell, metres
    headings: int = 16  # number of headings in a full turn
    lever: float = 1.0  # metres of driving that cost as much as a radian of turning
    clearance: float = 0.6  # distance that the base prefers to keep from solids, metres
    crowded: float = 6.0  # additional cost of a metre right beside a solid
    sideways: float = 1.0  # additional cost of a metre sideways; a metre backwards has twice that
    foresight: float = 10.0  # seconds for which solids are assumed to move on
    greed: float = 1.3  # factor of the estimated cost ahead; paths may cost more by this factor


LATTICE = BaseLattice()

_TURN = 2.0 * math.pi / LATTICE.headings
_MOST_CELLS = 10_000_000


def lattice_moves(*, omnidirectional: bool) -> NDArray[np.int64]:
    """Return the moves from each heading, shape (headings, m, 4).

    A move has its steps along x, y and heading, and its cost in millimetres.
    """
    moves = []
    for heading in range(LATTICE.headings):
        angle = _TURN * heading
        steps = [(0, 0, rotation) for rotation in (-1, 1)]
        if omnidirectional:
            around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
            steps += [(i, j, rotation) for i, j in around for rotation in (-1, 0, 1)]
        else:
            reach = 2.2 if heading % 2 else 1.4  # to a corner, or as in a knight's move
            i, j = (round(reach * f(angle)) for f in (np.cos, np.sin))
            steps += [(i, j, rotation) for rotation in (-1, 0, 1)] + [(-i, -j, 0)]
        costs = []
        for i, j, rotation in steps:
            aside = 1.0 - math.cos(math.atan2(j, i) - angle) if i or j else 0.0
            length = LATTICE.cell * math.hypot(i, j) * (1.0 + LATTICE.sideways * aside)
            costs.append(round(1000 * max(length, LATTICE.lever * _TURN * abs(rotation))))
        moves.append([(*step, cost) for step, cost in zip(steps, costs, strict=True)])
    return np.array(moves)


def driving_costs(
    solids: Solids, low: Array, high: Array, cell: float, disc: tuple[float, float]
) -> Array:
    """Return the cost of a metre of driving at each cell, shape (x, y).

    Args:
        solids: In the world, one row; moving solids are left out.
        low: Position of the first cell, shape (2,), metres.
        high: Position that the last cell reaches, shape (2,), metres.
        cell: Side of a cell, metres.
        disc: Radius and height of a disc within the base, metres; where it touches a solid, the
            cost is infinite.

    Raises:
        KinfeasError: If there would be too many cells.
    """
    pose, size, preferred = solids.pose[0], solids.size[0], disc[0] + LATTICE.clearance
    rows = ~solids.velocity[0].any(axis=1) & (size[:, 2] <= disc[1]) & (disc[1] <= size[:, 3])
    prisms = make_prisms(pose[rows], size[rows], solids.cylinder[0, rows])
    nx, ny = (np.ceil((high - low) / cell).astype(np.int64) + 1).tolist()
    if nx * ny > _MOST_CELLS:
        raise KinfeasError(
            f"solids and base are {nx * cell:.0f} x {ny * cell:.0f} m apart, too far"
        )
    gaps, _ = scan_grid(prisms, low, cell, 0.0, (nx, ny, 0), preferred, 0.0)
    near = 1.0 - gaps / preferred
    return np.where(gaps < disc[0], np.inf, 1.0 + LATTICE.crowded * near * near)


class Query(NamedTuple):
    """A query for a base path among solids.

    The arm is at rest, except within `reach` of start and goals. Moving solids count where they
    will be when the base comes by.
    """

    model: CollisionModel  # shapes of the robot
    rest: Array  # arm joints while driving, shape (j,)
    reach: float  # metres
    start: Array  # x, y and yaw of the base, shape (3,)
    goals: Array  # x, y and yaw of base poses at which it may arrive, shape (p, 3)
    goal_costs: Array  # cost of arriving there, shape (p,), metres
    solids: tuple[Array, Array, NDArray[np.bool_], Array]  # pose, size, cylinder and velocity
    origin: Array  # position of the first cell, shape (2,), metres
    driving: Array  # `driving_costs`
    moves: NDArray[np.int64]  # `lattice_moves`
    speed: Array  # of the base, m/s and rad/s


class Search(NamedTuple):
    """State of a search. Its nodes are those of the lattice, then the goals."""

    frontier: Frontier
    seconds: Array  # time at which the base is at a node, shape (lattice nodes,)
    ahead: Frontier  # of the search for the cheapest path from each cell to a goal, for a disc
    metre_cost: Array  # finite `driving_costs`
    first: int  # node of the start
    ends: NDArray[np.int64]  # nodes of the goals, shape (p,)
    moving: np.bool_  # whether any solid moves
    outlines: tuple[Array, Array]  # `bounds` of the shapes on the base and on the arm
    base: Array  # memory for a base pose
    local: Array  # memory for poses of the solids in the base frame
    scratch: CollisionScratch


@kernel
def search_base(query: Query):
    """Return base poses on the cheapest path to a goal, (k, 3), and the goal's index, or -1."""
    search = _begin(query)
    frontier, first, total = search.frontier, search.first, len(search.seconds)
    while True:
        node = close_next(frontier)
        if node < 0:
            return np.empty((0, 3)), -1
        if node >= total:
            return _path(query, path_to(frontier, frontier.parent[node])), node - total
        goal = _goal_at(query, search, node)
        if goal >= 0:  # arrivals are nodes of their own, since goals have costs
            cost = frontier.cost[node] + query.goal_costs[goal]
            open_node(frontier, total + goal, node, cost, cost)
        # Without moving solids, nodes are checked here: most are opened, but never closed.
        if goal >= 0 or node == first or search.moving or not _touches(query, search, node, 0.0):
            _expand(query, search, node)


@kernel
def _begin(query):
    nx, ny = query.driving.shape
    total, first = nx * ny * LATTICE.headings, _node(query.start, query.origin, ny)
    ends = np.empty(len(query.goals), dtype=np.int64)
    for p in range(len(ends)):
        ends[p] = _node(query.goals[p], query.origin, ny)
    free = np.isfinite(query.driving)
    metre_cost = np.minimum(query.driving, 1.0 + LATTICE.crowded)
    ahead = search_grid(
        free.reshape(nx, ny, 1), metre_cost, LATTICE.cell, 0.0,
        ends // LATTICE.headings, query.goal_costs, -1,
    )  # fmt: skip
    frontier, seconds = make_frontier(total + len(ends)), np.empty(total)
    scratch = make_collision_scratch(query.model)
    place_shapes(query.model, query.rest, scratch)
    outlines = bounds(query.model, False, scratch), bounds(query.model, True, scratch)
    pose, _, _, velocity = query.solids
    seconds[first] = 0.0
    if ahead.slot[first // LATTICE.headings] != UNSEEN:
        open_node(frontier, first, first, 0.0, 0.0)
    return Search(
        frontier, seconds, ahead, metre_cost, first, ends, np.any(velocity != 0.0), outlines,
        np.empty(3), np.empty_like(pose), scratch,
    )  # fmt: skip


@kernel
def _path(query, nodes):
    path = np.empty((len(nodes), 3))
    for k in range(len(nodes)):
        _write_base(query, nodes[k], path[k])
    return path


@inlined
def _goal_at(query, search, node):
    """Return the index of the cheapest goal at a node, or -1."""
    best = -1
    for p in range(len(search.ends)):
        if search.ends[p] == node and (best < 0 or query.goal_costs[p] < query.goal_costs[best]):
            best = p
    return best


@inlined
def _expand(query, search, node):
    """Open the nodes that moves from a node lead to; `greed` weighs the estimated cost ahead."""
    frontier, metre_cost, ahead = search.frontier, search.metre_cost, search.ahead
    nx, ny = metre_cost.shape
    heading, x, y = _coordinates(node, ny)
    for m in range(query.moves.shape[1]):
        step_x, step_y, step_heading, length = query.moves[heading, m]
        i, j = x + step_x, y + step_y
        if i < 0 or j < 0 or i >= nx or j >= ny or ahead.slot[i * ny + j] == UNSEEN:
            continue
        turned = (heading + step_heading) % LATTICE.headings
        other = (i * ny + j) * LATTICE.headings + turned
        cost = frontier.cost[node]
        cost += 0.0005 * length * (metre_cost[x, y] + metre_cost[i, j])
        if not improves(frontier, other, cost):
            continue
        if search.moving:  # by another path, solids may have left when the base arrives
            driven = LATTICE.cell * math.hypot(step_x, step_y)
            angle = _TURN * abs(step_heading)
            seconds = search.seconds[node] + max(driven / query.speed[0], angle / query.speed[1])
            if _touches(query, search, other, min(seconds, LATTICE.foresight)):
                continue
            search.seconds[other] = seconds
        open_node(frontier, other, node, cost, cost + LATTICE.greed * ahead.cost[i * ny + j])


@inner
def _node(base, origin, ny):
    """Return the number of the node nearest to a base pose x, y and yaw."""
    x = int((base[0] - origin[0]) / LATTICE.cell + 0.5)
    y = int((base[1] - origin[1]) / LATTICE.cell + 0.5)
    heading = math.floor(base[2] / _TURN + 0.5) % LATTICE.headings
    return (x * ny + y) * LATTICE.headings + heading


@inner
def _coordinates(node, ny):
    """Return heading, x and y of a node, in steps of the lattice."""
    cell = node // LATTICE.headings
    return node % LATTICE.headings, cell // ny, cell % ny


@inner
def _write_base(query, node, out):
    heading, x, y = _coordinates(node, query.driving.shape[1])
    out[0] = query.origin[0] + LATTICE.cell * x
    out[1] = query.origin[1] + LATTICE.cell * y
    out[2] = _TURN * heading


@inlined
def _touches(query, search, node, seconds):
    """Return whether the robot at a node touches solids after some seconds."""
    model, base, local, scratch = query.model, search.base, search.local, search.scratch
    pose, size, cylinder, velocity = query.solids
    _write_base(query, node, base)
    cosine, sine = math.cos(base[2]), math.sin(base[2])
    for k in range(len(pose)):
        dx = pose[k, 0] + velocity[k, 0] * seconds - base[0]
        dy = pose[k, 1] + velocity[k, 1] * seconds - base[1]
        local[k, 0], local[k, 1] = cosine * dx + sine * dy, cosine * dy - sine * dx
        local[k, 2] = pose[k, 2] - base[2]
    if touches_solids(model, False, search.outlines[0], local, size, cylinder, scratch):
        return True
    if _within(base, query.start, query.reach):
        return False
    for p in range(len(query.goals)):
        if _within(base, query.goals[p], query.reach):
            return False
    return touches_solids(model, True, search.outlines[1], local, size, cylinder, scratch)


@inlined
def _within(base, other, reach):
    return square(base[0] - other[0]) + square(base[1] - other[1]) <= square(reach)
