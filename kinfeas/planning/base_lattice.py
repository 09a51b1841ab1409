"""Cheapest base paths among solids: A* on a lattice of x, y and heading."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.kernels import inner, kernel, square
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.self_collision import make_collision_scratch, place_shapes
from kinfeas.kinematics.solids import bounds, touches_solids
from kinfeas.planning.lattice import (
    UNSEEN,
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
    headings: int = 16  # in a full turn
    lever: float = 1.0  # metres of driving that take as long as a radian of turning
    clearance: float = 0.6  # distance that the base prefers to keep from solids, metres
    crowded: float = 6.0  # what a metre beside a solid costs more
    sideways: float = 1.0  # what a metre sideways costs more than one ahead; one back twice that
    foresight: float = 10.0  # seconds for which solids are assumed to move on
    greed: float = 1.3  # factor of the estimated cost ahead; paths may be longer by this


LATTICE = BaseLattice()

_TURN = 2.0 * math.pi / LATTICE.headings
_MOST_CELLS = 10_000_000


def lattice_moves(*, omnidirectional: bool) -> NDArray[np.int64]:
    """Return the moves from each heading, shape (headings, m, 4).

    Each has steps of x, y and heading, and a cost in millimetres.
    """
    moves = []
    for heading in range(LATTICE.headings):
        angle = _TURN * heading
        each = [(0, 0, side) for side in (-1, 1)]
        if omnidirectional:
            around = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
            each += [(i, j, side) for i, j in around for side in (-1, 0, 1)]
        else:
            reach = 2.2 if heading % 2 else 1.4  # to a corner, or as in a knight's move
            i, j = (round(reach * f(angle)) for f in (np.cos, np.sin))
            each += [(i, j, side) for side in (-1, 0, 1)] + [(-i, -j, 0)]
        costs = []
        for i, j, side in each:
            aside = 1.0 - math.cos(math.atan2(j, i) - angle) if i or j else 0.0
            length = LATTICE.cell * math.hypot(i, j) * (1.0 + LATTICE.sideways * aside)
            costs.append(round(1000 * max(length, LATTICE.lever * _TURN * abs(side))))
        moves.append([(*move, cost) for move, cost in zip(each, costs, strict=True)])
    return np.array(moves)


def driving_costs(
    solids: Solids, low: Array, high: Array, cell: float, disc: tuple[float, float]
) -> Array:
    """Return the cost of a metre of driving at each cell, shape (x, y).

    Args:
        solids: In the world, one row; those that move have no cost.
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


@kernel
def search_base(model, rest, reach, start, goals, goal_costs, solids, grid, moves, speed):
    """Return base poses on the cheapest path to a goal, shape (k, 3), and its number, or -1.

    Solids that move are where they will be when the base comes by.

    Args:
        model: Shapes of the robot.
        rest: Arm joints while driving, shape (j,).
        reach: Distance from start and goals within which the arm is not at rest, metres.
        start: x, y and yaw of the base, shape (3,).
        goals: The same where it may arrive, shape (p, 3).
        goal_costs: What it costs to arrive there, shape (p,), metres.
        solids: Pose, size, cylinder and velocity of one row of `Solids`.
        grid: Position of the first cell, and `driving_costs`.
        moves: From `lattice_moves`.
        speed: Of the base, m/s and rad/s.
    """
    origin, cost = grid
    pose, _, _, velocity = solids
    moving = np.any(velocity != 0.0)
    nx, ny = cost.shape
    total, first = nx * ny * LATTICE.headings, _node(start, origin, ny)
    ends = np.empty(len(goals), dtype=np.int64)
    for p in range(len(goals)):
        ends[p] = _node(goals[p], origin, ny)
    free, metre_cost = np.isfinite(cost), np.minimum(cost, 1.0 + LATTICE.crowded)
    ahead = search_grid(
        free.reshape(nx, ny, 1), metre_cost, LATTICE.cell, 0.0,
        ends // LATTICE.headings, goal_costs, -1,
    )  # fmt: skip
    frontier, seconds = make_frontier(total + len(goals)), np.empty(total)
    scratch = make_collision_scratch(model)
    place_shapes(model, rest, scratch)
    near = np.concatenate((start[np.newaxis], goals)), square(reach)
    around = bounds(model, False, scratch), bounds(model, True, scratch)
    base, local = np.empty(3), np.empty_like(pose)
    seconds[first] = 0.0
    if ahead.slot[first // LATTICE.headings] != UNSEEN:
        open_node(frontier, first, first, 0.0, 0.0)
    while True:
        node = close_next(frontier)
        if node < 0:
            return np.empty((0, 3)), -1
        if node >= total:  # the arrival at a goal, at its whole cost
            nodes = path_to(frontier, frontier.parent[node])
            path = np.empty((len(nodes), 3))
            for k in range(len(nodes)):
                _write_base(nodes[k], origin, ny, path[k])
            return path, node - total
        best = -1
        for p in range(len(goals)):
            if ends[p] == node and (best < 0 or goal_costs[p] < goal_costs[best]):
                best = p
        if best >= 0:
            arrival = frontier.cost[node] + goal_costs[best]
            open_node(frontier, total + best, node, arrival, arrival)
        elif node != first and not moving:  # not before, since most are seen and never come to
            _write_base(node, origin, ny, base)
            if _touches(model, around, base, near, solids, 0.0, local, scratch):
                continue
        heading, x, y = _coordinates(node, ny)
        for m in range(moves.shape[1]):
            step_x, step_y, step_heading, length = moves[heading, m]
            i, j = x + step_x, y + step_y
            if i < 0 or j < 0 or i >= nx or j >= ny or ahead.slot[i * ny + j] == UNSEEN:
                continue
            turned = (heading + step_heading) % LATTICE.headings
            other = (i * ny + j) * LATTICE.headings + turned
            new = frontier.cost[node]
            new += 0.0005 * length * (metre_cost[x, y] + metre_cost[i, j])
            if not improves(frontier, other, new):
                continue
            if moving:  # solids may have left when the base comes by another path
                driven = LATTICE.cell * math.hypot(step_x, step_y)
                angle = _TURN * abs(step_heading)
                time = seconds[node] + max(driven / speed[0], angle / speed[1])
                _write_base(other, origin, ny, base)
                then = min(time, LATTICE.foresight)
                if _touches(model, around, base, near, solids, then, local, scratch):
                    continue
                seconds[other] = time
            estimate = new + LATTICE.greed * ahead.cost[i * ny + j]
            open_node(frontier, other, node, new, estimate)


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
def _write_base(node, origin, ny, out):
    heading, x, y = _coordinates(node, ny)
    out[0], out[1] = origin[0] + LATTICE.cell * x, origin[1] + LATTICE.cell * y
    out[2] = _TURN * heading


@inner
def _touches(model, around, base, near, solids, seconds, local, scratch):
    """Return whether the robot at a base pose, shape (3,), touches solids after some seconds.

    `around` are the `bounds` of the shapes on the base and on the arm. The arm counts only beyond a
    squared distance from the positions in `near`, (p, 3). `local` and `scratch` are memory.
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
    poses, squared = near
    for p in range(len(poses)):
        if square(base[0] - poses[p, 0]) + square(base[1] - poses[p, 1]) <= squared:
            return False
    return touches_solids(model, True, around[1], local, size, cylinder, scratch)
