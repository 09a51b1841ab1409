"""Obstacles around a robot's base: nearest points, and rays from its corners."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.sensing import AS_NEAR

_AT_SIDE = 0.02  # m, largest distance of a point on the side of a solid
_STEEP = 0.5  # horizontal part of a unit normal below which an obstacle is above or beneath


@dataclass(frozen=True)
class Shape:
    """A shape of the base: lowest and highest z (m), outline from above (m, 2), base frame."""

    low: float
    high: float
    corners: Array

    @staticmethod
    def around(points: Array) -> "Shape":
        """Return the shape of points in the base frame, shape (k, 3)."""
        outline = points[ConvexHull(points[:, :2], qhull_options="QJ").vertices, :2]
        return Shape(points[:, 2].min(), points[:, 2].max(), outline)


@dataclass(frozen=True)
class Obstacle:
    """An obstacle as in `ObstacleDistances` and its height, in the world frame."""

    closest_point: Array
    normal: Array
    distance: float
    height: float


Cast = Callable[[Array, Array, float], Iterable[Obstacle]]
"""Returns the hits of rays from points (c, 2) in a direction (2,) at a height, metres."""


def obstacles_around(
    planar: tuple[float, float, float],
    nearest: Iterable[Sequence[Obstacle]],
    shapes: Iterable[Shape],
    cast: Cast,
) -> list[Obstacle]:
    """Return the obstacles around one base, in the world frame.

    A side parallel to a wall has one nearest point, anywhere on it. If the base kept a distance of
    this point only, it could rotate about it into the wall.

    Args:
        planar: x, y and yaw of the base.
        nearest: The nearest points to each object, from `is_beside` obstacles.
        shapes: The base.
        cast: Engine's rays.
    """
    x, y, heading = planar
    obstacles: list[Obstacle] = []
    for points in nearest:
        if not points:
            continue
        obstacles += points
        closest = min(points, key=lambda point: point.distance)
        corners = [shape.corners for shape in shapes if shape.low <= closest.height <= shape.high]
        if corners:
            starts = np.concatenate(corners) @ rotation_matrix(heading).T + [x, y]
            ahead = closest.normal / np.linalg.norm(closest.normal)
            near = (closest.closest_point - starts) @ ahead <= AS_NEAR
            obstacles += cast(starts[near], ahead, closest.height)
    return obstacles


def obstacle_distances(planar: Array, around: Sequence[Sequence[Obstacle]]) -> ObstacleDistances:
    """Return the obstacles around n bases in their frames.

    `planar` are x, y and yaw of the bases, shape (n, 3); the obstacles are in the world frame.
    """
    width = max(map(len, around))
    point, normal = np.zeros((2, len(around), width, 2))
    distance = np.full((len(around), width), np.inf)
    for row, obstacles in enumerate(around):
        for k, obstacle in enumerate(obstacles):
            point[row, k] = obstacle.closest_point - planar[row, :2]
            normal[row, k], distance[row, k] = obstacle.normal, obstacle.distance
    to_base = rotation_matrix(planar[:, 2])
    return ObstacleDistances(point @ to_base, normal @ to_base, distance)


def closing_speeds(obstacles: ObstacleDistances, planar: Array, solids: Solids) -> Array:
    """Return the speeds at which solids move towards the bases' points, shape (n, k), m/s.

    Args:
        obstacles: Obstacles of n robots.
        planar: x, y and yaw of the bases, shape (n, 3).
        solids: n rows; from above, an obstacle is the solid whose side is nearest to its point.
    """
    near = np.isfinite(obstacles.distance)
    gap = np.where(near, obstacles.distance, 0.0)[..., np.newaxis] * obstacles.normal
    to_world = rotation_matrix(planar[:, 2]).swapaxes(1, 2)
    points = (obstacles.closest_point + gap) @ to_world + planar[:, np.newaxis, :2]
    sideways = solids.gaps(np.concatenate([points, np.zeros_like(points[..., :1])], axis=2))[0]
    owner = sideways.argmin(axis=2)
    velocity = np.take_along_axis(solids.velocity, owner[..., np.newaxis], axis=1)
    closing = -(velocity * (obstacles.normal @ to_world)).sum(axis=2)
    return np.where(near & (sideways.min(axis=2) < _AT_SIDE), closing, 0.0)


def is_beside(normal: Sequence[float] | Array) -> bool:
    """Return whether a unit normal (3,) belongs to an obstacle beside the base."""
    return bool(np.hypot(normal[0], normal[1]) >= _STEEP)


def rotation_matrix(heading: float | Array) -> Array:
    """Return rotation matrices of angles in radians, shape (...) -> (..., 2, 2)."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.stack([cosine, -sine, sine, cosine], axis=-1).reshape(*np.shape(heading), 2, 2)
