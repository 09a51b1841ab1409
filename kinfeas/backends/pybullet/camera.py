"""Pictures of the PyBullet world without a screen, and its state kept to be shown again."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.physics import ROOT, Physics
from kinfeas.core.spatial import Array

_FIELD = np.deg2rad(42.0)
_NEAR, _FAR = 0.1, 40.0  # m
_LIGHT = [2.0, -3.0, 8.0]
_ABOVE = 40.0  # m, from where the floor is looked at

Moment = tuple[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...]
"""Of each body the position and orientation of its root and the positions of its joints."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera saw.

    Attributes:
        colour: Shape (h, w, 3), 0-255.
        depth: Distance along the line of sight, shape (h, w), metres.
        seen: What each pixel shows, shape (h, w): the number of a body plus `LINK` times the
            index of its link plus one; -1 for nothing.
        view: World to camera, shape (4, 4).
        projection: Camera to clip space, shape (4, 4).
    """

    colour: NDArray[np.uint8]
    depth: Array
    seen: NDArray[np.intp]
    view: Array
    projection: Array

    def project(self, points: Array) -> Array:
        """Return where world points (n, 3) are seen: x and y in pixels, and their depth, (n, 3)."""
        height, width = self.depth.shape
        whole = np.column_stack([points, np.ones(len(points))])
        camera = whole @ self.view.T
        clip = camera @ self.projection.T
        ahead = np.maximum(clip[:, 3:], 1e-6)
        x, y = (clip[:, :2] / ahead).T
        return np.column_stack([(x + 1.0) * width / 2.0, (1.0 - y) * height / 2.0, -camera[:, 2]])

    def places(self) -> Array:
        """Return the world point that each pixel shows, shape (h, w, 3)."""
        height, width = self.depth.shape
        # PyBullet's renderer looks through the lower left corner of each pixel.
        across = (2.0 * np.arange(width) / width - 1.0) / self.projection[0, 0]
        up = (1.0 - 2.0 * (np.arange(height) + 1.0) / height) / self.projection[1, 1]
        rays = np.stack(np.broadcast_arrays(across, up[:, np.newaxis], -1.0), axis=-1)
        camera = rays * self.depth[..., np.newaxis] - self.view[:3, 3]
        there: Array = camera @ self.view[:3, :3]
        return there


LINK = 1 << 24
"""What PyBullet multiplies the index of a link with in its pictures."""


def take_picture(physics: Physics, eye: Array, target: Array, size: tuple[int, int]) -> Picture:
    """Return what a camera sees that stands at `eye`, shape (3,), and looks at `target`, (3,).

    It is drawn by PyBullet's own renderer, which needs neither screen nor graphics card.

    Args:
        physics: World to look at.
        eye: Where the camera is, metres.
        target: What is in the middle of its picture.
        size: Width and height in pixels.
    """
    client, (width, height) = physics.client, size
    view = client.computeViewMatrix(eye.tolist(), target.tolist(), [0.0, 0.0, 1.0])
    projection = client.computeProjectionMatrixFOV(
        float(np.rad2deg(_FIELD)), width / height, _NEAR, _FAR
    )
    colour, depth, seen = _draw(client, size, view, projection)
    nearness = np.reshape(np.asarray(depth, dtype=np.float64), (height, width))
    return Picture(
        np.reshape(np.asarray(colour, dtype=np.uint8), (height, width, 4))[:, :, :3],
        _FAR * _NEAR / (_FAR - (_FAR - _NEAR) * nearness),
        seen,
        np.reshape(np.array(view), (4, 4)).T,
        np.reshape(np.array(projection), (4, 4)).T,
    )


def covered_floor(physics: Physics, centre: Array, half: float, cells: int) -> NDArray[np.bool_]:
    """Return which parts of the floor something stands above, shape (cells, cells): x, then y.

    Args:
        physics: World to look at.
        centre: Middle of the square that is looked at, shape (2,), metres.
        half: Half its side, metres.
        cells: How finely it is divided.
    """
    x, y = centre.tolist()
    view = physics.client.computeViewMatrix([x, y, _ABOVE], [x, y, 0.0], [0.0, 1.0, 0.0])
    # From so far away rays are nearly parallel; PyBullet's renderer knows no others.
    field = float(np.rad2deg(2.0 * np.arctan(half / _ABOVE)))
    narrow = physics.client.computeProjectionMatrixFOV(field, 1.0, 0.8 * _ABOVE, 1.1 * _ABOVE)
    _, _, seen = _draw(physics.client, (cells, cells), view, narrow)
    body = np.where(seen < 0, physics.floor, seen % LINK)
    covered: NDArray[np.bool_] = np.not_equal(body[::-1].T, physics.floor)
    return covered


def _draw(
    client: Any, size: tuple[int, int], view: Any, projection: Any
) -> tuple[Any, Any, NDArray[np.intp]]:
    """Return colours and depths as PyBullet tells them, and what is seen, shape (h, w)."""
    width, height = size
    # Its shadows would darken all that they may reach.
    _, _, colour, depth, seen = client.getCameraImage(
        width, height, view, projection,
        renderer=client.ER_TINY_RENDERER,
        flags=client.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
        shadow=0, lightDirection=_LIGHT, lightDistance=6.0,
        lightAmbientCoeff=0.62, lightDiffuseCoeff=0.42, lightSpecularCoeff=0.02,
    )  # fmt: skip
    return colour, depth, np.reshape(np.asarray(seen, dtype=np.intp), (height, width))


def unit_width(size: tuple[int, int]) -> float:
    """Return the metres that a picture is wide at a distance of one metre, its lesser side."""
    width, height = size
    return float(2.0 * np.tan(_FIELD / 2.0) * min(1.0, width / height))


def keep_moment(physics: Physics) -> Moment:
    """Return where all bodies of a world are."""
    client = physics.client
    kept = []
    for body in range(client.getNumBodies()):
        joints = range(client.getNumJoints(body))
        states = client.getJointStates(body, list(joints)) if joints else ()
        position, orientation = client.getBasePositionAndOrientation(body)
        kept.append((position, orientation, tuple(state[0] for state in states)))
    return tuple(kept)


def show_moment(physics: Physics, moment: Moment) -> None:
    """Put all bodies of a world where they were, at rest."""
    client = physics.client
    for body, (position, orientation, joints) in enumerate(moment):
        client.resetBasePositionAndOrientation(body, position, orientation)
        for joint, at in enumerate(joints):
            client.resetJointState(body, joint, at)


@dataclass(frozen=True, eq=False)
class Solid:
    """A primitive that is seen, in the frame of its link.

    Attributes:
        body: PyBullet's number of the body.
        link: Index of its link.
        kind: `box`, `cylinder` or `sphere`.
        size: As in `robots.tree.Shape`.
        pose: In the frame of the link, shape (7,).
        colour: Red, green and blue, 0-1.
    """

    body: int
    link: int
    kind: str
    size: tuple[float, ...]
    pose: Array
    colour: tuple[float, ...]


def solids(physics: Physics) -> list[Solid]:
    """Return all primitives that are seen in a world; the floor and meshes are left out."""
    client = physics.client
    bodies = (body for body in range(client.getNumBodies()) if body != physics.floor)
    shapes = (shape for body in bodies for shape in client.getVisualShapeData(body))
    return [solid for shape in shapes if (solid := _solid(client, shape)) is not None]


def _solid(client: Any, shape: Any) -> Solid | None:
    body, link, kind, size, _, position, orientation, colour = shape[:8]
    kinds = {
        client.GEOM_BOX: ("box", size),
        client.GEOM_CYLINDER: ("cylinder", (size[1], size[0])),
        client.GEOM_SPHERE: ("sphere", size[:1]),
    }
    if kind not in kinds:
        return None
    name, measures = kinds[kind]
    pose = np.array([*position, *orientation])
    return Solid(body, link, name, tuple(measures), pose, tuple(colour[:3]))


def link_poses(physics: Physics, links: list[tuple[int, int]]) -> Array:
    """Return the world poses of some links, each a body and an index; shape (n, 7)."""
    return np.stack([physics.link_pose(body, link) for body, link in links])


def paint_floor(physics: Physics, texture: Path) -> None:
    """Give the floor a picture of two by two tiles of one metre in place of PyBullet's own."""
    client = physics.client
    number = client.loadTexture(str(texture))
    client.changeVisualShape(physics.floor, ROOT, textureUniqueId=number)
