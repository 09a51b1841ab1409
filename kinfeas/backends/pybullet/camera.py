"""Pictures of a PyBullet world without a screen, and its state at a moment."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.spatial import Array
from kinfeas.robots.urdf import Shape

FIELD_OF_VIEW = np.deg2rad(42.0)  # vertical
_NEAR, _FAR = 0.1, 40.0  # m
_LIGHT = [2.0, -3.0, 8.0]
_SIDE_VIEW = (480, 360)
_CHEST = 0.7  # m above the floor, the middle of a robot
_BESIDE, _UP, _NEAREST = 0.6, 0.55, 2.4  # of the distance to the goal; m

Moment = tuple[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...]
"""Of each body the position and orientation of its root and the positions of its joints."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture, shape (h, w, 3), 0-255, and the matrices (4, 4) from world to clip space."""

    colour: NDArray[np.uint8]
    view: Array
    projection: Array

    def project(self, points: Array) -> Array:
        """Return pixel x and y and the depth of world points, (n, 3) to (n, 3)."""
        height, width, _ = self.colour.shape
        whole = np.column_stack([points, np.ones(len(points))])
        camera = whole @ self.view.T
        clip = camera @ self.projection.T
        ahead = np.maximum(clip[:, 3:], 1e-6)
        x, y = (clip[:, :2] / ahead).T
        return np.column_stack([(x + 1.0) * width / 2.0, (1.0 - y) * height / 2.0, -camera[:, 2]])


def take_picture(physics: Physics, eye: Array, target: Array, size: tuple[int, int]) -> Picture:
    """Return a picture from `eye` to `target`, (3,) metres; size: width and height, pixels."""
    client, (width, height) = physics.client, size
    view = client.computeViewMatrix(eye.tolist(), target.tolist(), [0.0, 0.0, 1.0])
    projection = client.computeProjectionMatrixFOV(
        float(np.rad2deg(FIELD_OF_VIEW)), width / height, _NEAR, _FAR
    )
    # Its shadows darken everything within their reach.
    _, _, colour, _, _ = client.getCameraImage(
        width, height, view, projection, renderer=client.ER_TINY_RENDERER,
        flags=client.ER_NO_SEGMENTATION_MASK, shadow=0, lightDirection=_LIGHT, lightDistance=6.0,
        lightAmbientCoeff=0.62, lightDiffuseCoeff=0.42, lightSpecularCoeff=0.02,
    )  # fmt: skip
    return Picture(
        np.reshape(np.asarray(colour, dtype=np.uint8), (height, width, 4))[:, :, :3].copy(),
        np.reshape(np.array(view), (4, 4)).T,
        np.reshape(np.array(projection), (4, 4)).T,
    )


def take_side_view(physics: Physics, base: Array, goal: Array) -> NDArray[np.uint8]:
    """Return an RGB picture (360, 480, 3) of a robot at `base` (3,) and its goal (3,)."""
    base = base + np.array([0.0, 0.0, _CHEST])
    way = (goal - base) * [1.0, 1.0, 0.0]
    apart = max(float(np.linalg.norm(way)), 1e-3)
    across = np.array([way[1], -way[0], 0.0]) / apart
    away = max(apart + 0.8, _NEAREST)
    # From beside the way, a bit behind the robot.
    eye = (base + goal) / 2.0 + away * (across - _BESIDE * way / apart)
    eye[2] += _UP * away
    return take_picture(physics, eye, (base + goal) / 2.0, _SIDE_VIEW).colour


def keep_moment(physics: Physics) -> Moment:
    """Return the poses and joint positions of all bodies."""
    client = physics.client
    kept = []
    for body in range(client.getNumBodies()):
        joints = range(client.getNumJoints(body))
        states = client.getJointStates(body, list(joints)) if joints else ()
        position, orientation = client.getBasePositionAndOrientation(body)
        kept.append((position, orientation, tuple(state[0] for state in states)))
    return tuple(kept)


def show_moment(physics: Physics, moment: Moment) -> None:
    """Place all bodies at rest as at a moment."""
    client = physics.client
    for body, (position, orientation, joints) in enumerate(moment):
        client.resetBasePositionAndOrientation(body, position, orientation)
        for joint, at in enumerate(joints):
            client.resetJointState(body, joint, at)


@dataclass(frozen=True, eq=False)
class VisualShape:
    """A visible primitive: body, link, shape in the link's frame, colour as shares of 1."""

    body: int
    link: int
    shape: Shape
    colour: tuple[float, ...]


def visual_shapes(physics: Physics) -> list[VisualShape]:
    """Return the visible primitives of a world without its floor; meshes are left out."""
    client, found = physics.client, []
    for number in range(client.getNumBodies()):
        shapes = client.getVisualShapeData(number)
        for body, link, kind, size, _, position, orientation, colour, *_ in shapes:
            pose = np.array([*position, *orientation])
            if kind == client.GEOM_BOX:
                shape = Shape("box", tuple(size), pose)
            elif kind == client.GEOM_CYLINDER:
                shape = Shape("cylinder", (size[1], size[0]), pose)
            elif kind == client.GEOM_SPHERE:
                shape = Shape("sphere", (size[0],), pose)
            else:
                continue
            found.append(VisualShape(body, link, shape, tuple(colour[:3])))
    return found


def link_poses(physics: Physics, links: list[tuple[int, int]]) -> Array:
    """Return the world poses (n, 7) of links, each a body number and a link index."""
    return np.stack([physics.link_pose(body, link) for body, link in links])
