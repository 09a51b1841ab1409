"""Contacts of the simulated robot, and distances from its base to obstacles."""

from collections.abc import Collection, Iterable

import numpy as np

from kinfeas.backends.physics.obstacles import Obstacle, Shape, is_beside, obstacles_around
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core import spatial
from kinfeas.core.backend import Contacts
from kinfeas.core.spatial import Array

_OUTSIDE = 1e-3  # m before a corner where its ray starts, so that it does not hit the robot
_HIGH = 1e3  # m above and below the base within which there may be obstacles
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


class Surroundings:
    """Measures the obstacles around a robot's base.

    Args:
        body: The robot with its base at the origin.
    """

    def __init__(self, body: RobotBody) -> None:
        self._body = body
        self._shapes = _shapes(body)
        corners = [np.zeros((1, 2)), *(one.corners for one in self._shapes)]
        self._radius = np.linalg.norm(np.concatenate(corners), axis=1).max()

    def around(
        self, bodies: Iterable[int], within: float, handled: Collection[tuple[int, int]] = ()
    ) -> list[Obstacle]:
        """Return the obstacles within a distance (m), except `handled` links."""

        def cast(places: Array, ahead: Array, height: float) -> list[Obstacle]:
            heights = np.full((len(places), 1), height)
            begins, ends = (
                np.hstack([places + way * ahead, heights]).tolist() for way in (_OUTSIDE, within)
            )
            hits = self._body.physics.client.rayTestBatch(begins, ends)
            return [
                Obstacle(
                    place, -np.array(normal[:2]), float((place - hit[:2]) @ normal[:2]), hit[2]
                )
                for place, (other, link, _, hit, normal) in zip(places, hits, strict=True)
                if other not in (-1, self._body.body) and (other, link) not in handled
                if is_beside(normal)
            ]

        near = self._near(within)
        nearest = (self._closest(other, within, handled) for other in bodies if other in near)
        return obstacles_around(self._body.planar(), nearest, self._shapes, cast)

    def _near(self, within: float) -> frozenset[int]:
        """Return the bodies whose bounding boxes are within a distance of the base."""
        x, y, _ = self._body.planar()
        reach = self._radius + within
        corners = [x - reach, y - reach, -_HIGH], [x + reach, y + reach, _HIGH]
        return frozenset(
            body for body, _ in self._body.physics.client.getOverlappingObjects(*corners)
        )

    def _closest(
        self, other: int, within: float, handled: Collection[tuple[int, int]]
    ) -> list[Obstacle]:
        """Return the nearest points of each link of the base to each link of another body."""
        body = self._body
        points = body.physics.client.getClosestPoints(body.body, other, within)
        return [
            # The normal points from the object to the robot.
            Obstacle(np.array(place[:2]), -np.array(normal[:2]), distance, place[2])
            for _, _, _, own, link, place, _, normal, distance, *_ in points
            if own not in body.arm_links and (other, link) not in handled and is_beside(normal)
        ]


def _shapes(body: RobotBody) -> tuple[Shape, ...]:
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
            elif kind == client.GEOM_CAPSULE:
                pose, (length, radius, _) = np.concatenate([position, orientation]), size
                around = np.array([2.0 * radius, 2.0 * radius, length + 2.0 * radius])
                corners = _transformed(_UNIT_BOX * around, pose)
            else:  # spheres
                continue
            corners = _transformed(corners, frame)
            found.append(Shape.around(corners))
    return tuple(found)


def _transformed(points: Array, pose: Array) -> Array:
    return points @ spatial.rotation(pose).as_matrix().T + pose[:3]
