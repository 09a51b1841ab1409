"""Random solids on the floor, and room for robots between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import check_ascending
from kinfeas.core.quantities import Distance, Fraction, NotNegative
from kinfeas.core.solids import MOST_SOLIDS, Solids
from kinfeas.core.spatial import Array, compose, planar_pose
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.solids import base_collides, collides
from kinfeas.planning.placement import connected, footprint

SMALLEST = 0.2  # smallest length and width of a solid, metres
_WALL, _LOW, _TABLE = 2.0, (0.05, 0.35), (0.5, 0.9)  # heights of solids, metres
_REACH = (0.4, 0.9)  # distances from a goal at which the base needs room, metres
_CLEARANCE = 0.7  # radius of free discs around base and EE at the start, and around goals, metres


@dataclass(frozen=True)
class Clutter:
    """Random solids on a square grid, with Gaussian jitter and random yaw."""

    extent: Distance = 8.0  # side of the square of solids, metres
    spacing: Distance = 1.25  # distance of the grid, metres
    jitter: NotNegative = 0.3  # standard deviation from the grid, metres
    footprint: tuple[Distance, Distance] = (0.8, 0.6)  # largest sides, metres; the smallest are 0.2
    walls: Fraction = 1.0 / 3.0  # as high as the robot; the others are low, or high as tables
    cylinders: Fraction = 0.2  # fraction of cylinders, whose diameter is the width
    speed: tuple[Distance, Distance] = (0.0, 0.0)  # smallest and largest speed of the solids, m/s
    span: tuple[Distance, Distance] = (2.0, 3.0)  # distances after which moving solids turn, metres

    def __post_init__(self) -> None:
        for name in ("speed", "span"):
            check_ascending(name, getattr(self, name))

    def draw_solids(self, rng: np.random.Generator, centre: Array) -> Solids:
        """Return one row of solids around a centre, shape (2,)."""
        side = int(self.extent / self.spacing)
        line = (np.arange(side) - (side - 1) / 2.0) * self.spacing
        grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) + centre
        k = len(grid)
        half = rng.uniform(SMALLEST, self.footprint, (k, 2)) / 2.0
        cylinder = rng.random(k) < self.cylinders
        half = np.where(cylinder[:, np.newaxis], half[:, 1:], half)
        kind = rng.random(k)
        low, table = rng.uniform(*_LOW, k), rng.uniform(*_TABLE, k)
        height = np.where(kind < (1.0 + self.walls) / 2.0, low, table)
        height = np.where(kind < self.walls, _WALL, height)
        yaw, bearing = rng.uniform(-np.pi, np.pi, (2, k))
        speed = rng.uniform(*self.speed, k)
        xy = grid + rng.normal(0.0, self.jitter, (k, 2))
        row = Solids(
            pose=np.column_stack([xy, yaw]),
            size=np.column_stack([half, np.zeros(k), height]),
            cylinder=cylinder,
            velocity=speed[:, np.newaxis] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1),
            span=rng.uniform(*self.span, k),
        )
        return row.each(lambda values: values[np.newaxis])


def with_clutter(
    solver: IkSolver, start: Start, furniture: Solids, places: int, rng: np.random.Generator
) -> Solids:
    """Return one row of the furniture and of at most `places` random solids after it, if they fit.

    Random solids near the start or a goal, or overlapping furniture, are left out; of the others,
    those nearest to the route from start to goals are taken.
    """
    places = min(places, MOST_SOLIDS - furniture.places)
    ee = compose(start.base_pose, forward(solver.chain, start.joint_positions))
    ends = np.vstack([start.base_pose[:3], start.target_poses[:, :3], ee[:3]])
    route = ends[:-1, :2]
    drawn = Clutter().draw_solids(rng, (route.min(axis=0) + route.max(axis=0)) / 2.0)
    near = drawn.gaps(ends[np.newaxis])[0][0].min(axis=0) < _CLEARANCE
    centres = drawn.centre[..., :3]
    gaps = furniture.gaps(centres)[0][0].min(axis=1, initial=np.inf)
    overlaps = gaps < np.linalg.norm(drawn.size[0, :, :2], axis=1)
    away = np.linalg.norm(centres[..., :2] - route[:, np.newaxis], axis=2)
    legs = np.linalg.norm(np.diff(route, axis=0), axis=1)[:, np.newaxis]
    detour = (away[1:] + away[:-1] - legs).min(axis=0)
    left_out = near | overlaps | touches_robot(solver, start, drawn)
    order = np.argsort(np.where(left_out, np.inf, detour), kind="stable")
    order = order[: min(places, int(np.sum(~left_out)))]
    taken = furniture.joined(drawn.only(order))
    return Solids.empty(1, furniture.places + places).put(np.arange(1), taken)


def touches_robot(solver: IkSolver, start: Start, solids: Solids) -> NDArray[np.bool_]:
    """Return which of one row of k solids touch the robot at its start, shape (k,)."""
    alone = solids.each(lambda values: np.swapaxes(values, 0, 1))
    n = len(alone.pose)
    joints, base = np.tile(start.joint_positions, (n, 1)), np.tile(start.base_pose, (n, 1))
    return np.any(collides(solver.collision, joints, base, alone), axis=1)


def free_places(solver: IkSolver, goal: Array, moments: Solids) -> Array:
    """Return base poses near a goal, heading for it, that solids leave free, shape (m, 7).

    Args:
        solver: The robot's kinematics.
        goal: World pose of the EE, shape (7,).
        moments: The same solids at some moments, one a row.
    """
    bearings = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    bearing, away = np.tile(bearings, len(_REACH)), np.repeat(_REACH, len(bearings))
    x, y = goal[0] - away * np.cos(bearing), goal[1] - away * np.sin(bearing)
    base = planar_pose(x, y, bearing)
    for row in range(len(moments.pose)):
        solids = moments.of(np.full(len(base), row, dtype=np.intp))
        base = base[~base_collides(solver.collision, base, solids)]
    return base


def all_reachable(solver: IkSolver, start: Start, solids: Solids) -> bool:
    """Return whether a disc within the base can be driven to a free base pose near each goal."""
    places = [free_places(solver, goal, solids) for goal in start.target_poses]
    if not all(len(poses) for poses in places):
        return False
    disc = footprint(solver.collision)
    reached = connected(solids, start.base_pose[:2], np.concatenate(places)[:, :2], disc)
    parts = np.split(reached, np.cumsum([len(poses) for poses in places])[:-1])
    return all(part.any() for part in parts)
