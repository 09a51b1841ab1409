"""What stands near the robot's base."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core import spatial
from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.spatial import Array

_STEEP = 0.5
"""Horizontal share of a direction below which a thing is above or beneath, and not in the way."""

_AS_NEAR = 0.1
"""How much farther away than the nearest point of a thing corners are that see it, too, metres."""

_OUTSIDE = 1e-3
"""How far before a corner its ray begins, so that it does not meet the robot itself, metres."""

_SIGNS = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
"""Corners of a box of edge 1."""


@dataclass(frozen=True)
class _Shape:
    """A shape of the base, in the base frame.

    Attributes:
        low: Height where it begins, metres.
        high: Height where it ends.
        corners: Seen from above, shape (m, 2).
    """

    low: float
    high: float
    corners: Array


@dataclass(frozen=True)
class _Thing:
    """What is in the way: in world coordinates, all but its height as in `ObstacleDistances`."""

    closest_point: Array
    normal: Array
    distance: float
    height: float


class Surroundings:
    """Looks around a robot's base: at what is nearest to it, and at what is before its corners.

    A flat side that faces a wall has one nearest point, which may be anywhere on it. A base that
    kept that one away alone would turn about it, and into the wall.

    Args:
        body: The robot, as it was made: its base at the origin.
    """

    def __init__(self, body: RobotBody) -> None:
        self._body = body
        self._shapes = _shapes(body)

    def obstacle_distances(
        self, bodies: Iterable[int], within: float, handled: Collection[tuple[int, int]] = ()
    ) -> ObstacleDistances:
        """Return what is near to what the arm does not carry, as a batch of one.

        Args:
            bodies: PyBullet's numbers of what stands around.
            within: How far to look, metres.
            handled: Links that do not count: numbers of body and link.
        """
        things = []
        for other in bodies:
            closest = self._closest(other, within, handled)
            if closest:
                nearest = min(closest, key=lambda thing: thing.distance)
                things += [*closest, *self._before_corners(nearest, within, handled)]
        x, y, heading = self._body.planar()
        to_base = _turn(heading)
        points = np.array([one.closest_point for one in things]).reshape(1, -1, 2)
        normals = np.array([one.normal for one in things]).reshape(1, -1, 2)
        distance = np.array([[one.distance for one in things]])
        return ObstacleDistances((points - [x, y]) @ to_base, normals @ to_base, distance)

    def _closest(
        self, other: int, within: float, handled: Collection[tuple[int, int]]
    ) -> list[_Thing]:
        """Return the nearest points of each link of the base to each link of another body."""
        body = self._body
        points = body.physics.client.getClosestPoints(body.body, other, within)
        return [
            # The normal points from the thing to the robot.
            _Thing(np.array(place[:2]), -np.array(normal[:2]), distance, place[2])
            for _, _, _, own, link, place, _, normal, distance, *_ in points
            if own not in body.arm_links and (other, link) not in handled and _beside(normal)
        ]

    def _before_corners(
        self, thing: _Thing, within: float, handled: Collection[tuple[int, int]]
    ) -> list[_Thing]:
        """Return what is before the corners that are as high as a thing, seen in its direction."""
        corners = [one.corners for one in self._shapes if one.low <= thing.height <= one.high]
        if not corners:
            return []
        x, y, heading = self._body.planar()
        places = np.concatenate(corners) @ _turn(heading).T + [x, y]
        ahead = thing.normal / np.linalg.norm(thing.normal)
        places = places[(thing.closest_point - places) @ ahead <= _AS_NEAR]
        height = np.full((len(places), 1), thing.height)
        begins, ends = (
            np.hstack([places + way * ahead, height]).tolist() for way in (_OUTSIDE, within)
        )
        hits = self._body.physics.client.rayTestBatch(begins, ends)
        return [
            _Thing(place, -np.array(normal[:2]), float((place - hit[:2]) @ normal[:2]), hit[2])
            for place, (other, link, _, hit, normal) in zip(places, hits, strict=True)
            if other not in (-1, self._body.body) and (other, link) not in handled
            if _beside(normal)
        ]


def _beside(normal: tuple[float, float, float]) -> bool:
    return bool(np.hypot(normal[0], normal[1]) >= _STEEP)


def _turn(heading: float) -> Array:
    """Return the matrix that turns columns by an angle, and rows the other way."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([[cosine, -sine], [sine, cosine]])


def _shapes(body: RobotBody) -> tuple[_Shape, ...]:
    """Return the shapes with corners of what the arm does not carry."""
    client, found = body.physics.client, []
    for link in sorted({*body.links.values()} - body.arm_links):
        frame = body.physics.mass_pose(body.body, link)
        shapes = client.getCollisionShapeData(body.body, link)
        for number, (_, _, kind, size, _, position, orientation) in enumerate(shapes):
            if kind == client.GEOM_BOX:
                pose = np.concatenate([position, orientation])
                corners = _placed(_SIGNS * size, pose)
            elif kind == client.GEOM_MESH:  # which cylinders are, too
                corners = np.array(client.getMeshData(body.body, link, number)[1])
            else:  # spheres and capsules
                continue
            corners = _placed(corners, frame)
            low, high = corners[:, 2].min(), corners[:, 2].max()
            found.append(_Shape(low, high, _outline(corners[:, :2])))
    return tuple(found)


def _placed(points: Array, pose: Array) -> Array:
    """Return where points of a frame lie whose pose is of shape (7,)."""
    return points @ spatial.rotation(pose).as_matrix().T + pose[:3]


def _outline(points: Array) -> Array:
    """Return the corners of the convex hull of points, shape (m, 2)."""
    from scipy.spatial import ConvexHull

    return points[ConvexHull(points, qhull_options="QJ").vertices]
