"""Shapes of some links, seen from one of them."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from kinfeas.core.spatial import IDENTITY, Array, compose, relative, rotation
from kinfeas.robots.urdf import Shape, Urdf


class Placed(NamedTuple):
    """A shape and the pose of its centre, shape (7,), metres, in the frame that was asked for."""

    shape: Shape
    pose: Array

    def reach(self, direction: Array) -> float:
        """Return how far the shape goes in a direction, a unit vector (3,), metres."""
        along = rotation(self.pose).inv().apply(direction)
        middle, size = float(self.pose[:3] @ direction), self.shape.size
        if self.shape.kind == "box":
            return middle + float(np.abs(along) @ np.array(size)) / 2.0
        if self.shape.kind == "cylinder":
            radius, length = size
            return middle + radius * float(np.hypot(*along[:2])) + abs(along[2]) * length / 2.0
        return middle + size[0]


def place(
    urdf: Urdf, links: Iterable[str], frame: str, positions: Mapping[str, float]
) -> list[Placed]:
    """Return the shapes of some links.

    Args:
        urdf: The robot.
        links: Names of the links.
        frame: The link that they are seen from.
        positions: Of joints that follow no other, rad or m; the rest are as near 0 as they can.
    """
    at = link_pose(urdf, frame, positions)
    return [
        Placed(shape, relative(compose(link_pose(urdf, link, positions), shape.pose), at))
        for link in links
        for shape in urdf.links[link].shapes
    ]


def link_pose(urdf: Urdf, link: str, positions: Mapping[str, float]) -> Array:
    """Return the pose of a link seen from the root, shape (7,); positions as above."""
    pose = IDENTITY
    for joint in urdf.path_to(link):
        leader, scale, offset = urdf.followed(joint)
        rest = min(max(0.0, leader.lower), leader.upper)
        pose = compose(pose, joint.pose_at(scale * positions.get(leader.name, rest) + offset))
    return pose
