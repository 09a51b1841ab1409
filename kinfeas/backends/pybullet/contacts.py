"""Contacts of the simulated robot, and distances from its base to obstacles."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core import spatial
from kinfeas.core.backend import Contacts, ObstacleDistances
from kinfeas.core.spatial import Array

_STEEP = 0.5  # horizontal part of a unit normal below which an object is above or beneath
_AS_NEAR = 0.1  # m beyond the nearest point within which corners of the base are used, too
_OUTSIDE = 1e-3  # m before a corner where its ray starts, so that it does not hit the robot
_UNIT_BOX = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T


def contacts(body: RobotBody, handled: Collection[tuple[int, int]] = ()) -> Contacts:
    """Return the contacts of a robot, except those with `handled` links (body, link).

    The robot's own links, and the floor below its base, do not count.
    """
    points = body.physics.client.getContactPoints(bodyA=body.body)
    touching = frozenset(
        (point[3], point[2], point[4])
        for point in points
        if point[8] <= 0.0 and point[2] != body.body and (point[2], point[4]) not in handled
    )
    arm = frozenset(contact for contact in touching if contact[0] in body.arm_links)
    return Contacts(touching - arm, arm)


@dataclass(frozen=True)
class _Shape:
    """A shape of the base: lowest and highest z (m), outline from above (m, 2), base frame."""

    low: float
    high: float
    corners: Array


@dataclass(frozen=True)
class _Obstacle:
    """An obstacle as in `ObstacleDistances` and its height, in the world frame."""

    closest_point: Array
    normal: Array
    distance: float
    height: float


class Surroundings:
    """Measures the obstacles around a robot's base: nearest points, and rays from its corners.

    A side parallel to a wall has one nearest point, anywhere on it. If the base kept a distance of
    this point only, it could rotate about it into the wall.

    Args:
        body: The robot with its base at the origin.
    """

    def __init__(self, body: RobotBody) -> None:
        self._body = body
        self._shapes = _shapes(body)

    def obstacle_distances(
        self, bodies: Iterable[int], within: float, handled: Collection[tuple[int, int]] = ()
    ) -> ObstacleDistances:
        """Return the obstacles within a distance (m) as a batch of 1, except `handled` links."""
        found = []
        for other in bodies:
            closest = self._closest(other, within, handled)
            if closest:
                nearest = min(closest, key=lambda one: one.distance)
                found += [*closest, *self._before_corners(nearest, within, handled)]
        x, y, heading = self._body.planar()
        to_base = _turn(heading)
        points = np.array([one.closest_point for one in found]).reshape(1, -1, 2)
        normals = np.array([one.normal for one in found]).reshape(1, -1, 2)
        distance = np.array([[one.distance for one in found]])
        return ObstacleDistances((points - [x, y]) @ to_base, normals @ to_base, distance)

    def _closest(
        self, other: int, within: float, handled: Collection[tuple[int, int]]
    ) -> list[_Obstacle]:
        """Return the nearest points of each link of the base to each link of another body."""
        body = self._body
        points = body.physics.client.getClosestPoints(body.body, other, within)
        return [
            # The normal points from the object to the robot.
            _Obstacle(np.array(place[:2]), -np.array(normal[:2]), distance, place[2])
            for _, _, _, own, link, place, _, normal, distance, *_ in points
            if own not in body.arm_links and (other, link) not in handled and _beside(normal)
        ]

    def _before_corners(
        self, nearest: _Obstacle, within: float, handled: Collection[tuple[int, int]]
    ) -> list[_Obstacle]:
        """Return what rays hit from corners at the height of an obstacle, in its direction."""
        corners = [one.corners for one in self._shapes if one.low <= nearest.height <= one.high]
        if not corners:
            return []
        x, y, heading = self._body.planar()
        places = np.concatenate(corners) @ _turn(heading).T + [x, y]
        ahead = nearest.normal / np.linalg.norm(nearest.normal)
        places = places[(nearest.closest_point - places) @ ahead <= _AS_NEAR]
        height = np.full((len(places), 1), nearest.height)
        begins, ends = (
            np.hstack([places + way * ahead, height]).tolist() for way in (_OUTSIDE, within)
        )
        hits = self._body.physics.client.rayTestBatch(begins, ends)
        return [
            _Obstacle(place, -np.array(normal[:2]), float((place - hit[:2]) @ normal[:2]), hit[2])
            for place, (other, link, _, hit, normal) in zip(places, hits, strict=True)
            if other not in (-1, self._body.body) and (other, link) not in handled
            if _beside(normal)
        ]


def _beside(normal: tuple[float, float, float]) -> bool:
    return bool(np.hypot(normal[0], normal[1]) >= _STEEP)


def _turn(heading: float) -> Array:
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.array([[cosine, -sine], [sine, cosine]])


def _shapes(body: RobotBody) -> tuple[_Shape, ...]:
    """Return the boxes and meshes of the links that the arm does not carry."""
    client, found = body.physics.client, []
    for link in sorted({*body.links.values()} - body.arm_links):
        frame = body.physics.mass_pose(body.body, link)
        shapes = client.getCollisionShapeData(body.body, link)
        for number, (_, _, kind, size, _, position, orientation) in enumerate(shapes):
            if kind == client.GEOM_BOX:
                pose = np.concatenate([position, orientation])
                corners = _transformed(_UNIT_BOX * size, pose)
            elif kind == client.GEOM_MESH:  # cylinders, too
                corners = np.array(client.getMeshData(body.body, link, number)[1])
            else:  # spheres and capsules
                continue
            corners = _transformed(corners, frame)
            low, high = corners[:, 2].min(), corners[:, 2].max()
            flat = corners[:, :2]
            outline = flat[ConvexHull(flat, qhull_options="QJ").vertices]
            found.append(_Shape(low, high, outline))
    return tuple(found)


def _transformed(points: Array, pose: Array) -> Array:
    return points @ spatial.rotation(pose).as_matrix().T + pose[:3]
