"""Pictures of shapes at poses that the caller sets, drawn by PyBullet on the processor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.physics import connect
from kinfeas.core.extras import require
from kinfeas.core.spatial import Array
from kinfeas.robots.urdf import Shape

SIZE = (480, 360)
"""Width and height of a picture in pixels."""

_FIELD = 40.0  # degrees, vertical field of view
_NEAR, _FAR = 0.05, 50.0  # m from the camera, the range that is drawn
# of half the field of view, along width and height
_TANGENTS = np.tan(np.deg2rad(_FIELD) / 2.0) * np.array([SIZE[0] / SIZE[1], 1.0])


@dataclass(frozen=True, eq=False)
class View:
    """Position and direction of a camera."""

    target: Array  # world position in the middle of the picture, shape (3,)
    distance: float  # from the camera to the target, metres
    heading: float  # world direction in which the camera looks, radians
    elevation: float  # angle by which it looks down, radians

    @staticmethod
    def of_box(low: Array, high: Array, heading: float, elevation: float) -> "View":
        """Return the nearest view in a direction that shows the box between two corners, (3,)."""
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T
        view = View((low + high) / 2.0, 0.0, heading, elevation)
        ahead, *across = view.axes @ (corners - view.target).T
        needed = (np.abs(across) / _TANGENTS[:, np.newaxis]).max(axis=0) - ahead
        return View(view.target, float(needed.max()), heading, elevation)

    @property
    def axes(self) -> Array:
        """World directions ahead, to the right and up in the picture, rows of shape (3, 3)."""
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        down = np.sin(self.elevation)
        ahead = np.array([*np.cos(self.elevation) * np.array([cosine, sine]), -down])
        right = np.array([sine, -cosine, 0.0])
        return np.stack([ahead, right, np.cross(right, ahead)])

    @property
    def position(self) -> Array:
        """World position of the camera, shape (3,)."""
        return self.target - self.distance * self.axes[0]

    def pixels(self, points: Array) -> Array:
        """Return pixel coordinates of world points (k, 3), shape (k, 2): to the right and down."""
        ahead, right, up = self.axes @ (points - self.position).T
        across = np.stack([right, -up], axis=1) / np.maximum(ahead, 1e-3)[:, np.newaxis]
        return (1.0 + across / _TANGENTS) * np.array(SIZE) / 2.0


class Camera:
    """Shapes in a world of their own, without physics; needs neither screen nor graphics card."""

    def __init__(self, shapes: Sequence[tuple[Shape, str]]) -> None:
        """Draw shapes with colours, `#rrggbb` or `#rrggbbaa`."""
        require("pybullet")
        self._client = client = connect(gui=False)
        self._bodies = []
        geometry: dict[str, Any]
        for shape, colour in shapes:
            if shape.kind == "box":
                geometry = {"halfExtents": [side / 2.0 for side in shape.size]}
                kind = client.GEOM_BOX
            elif shape.kind == "cylinder":
                geometry = {"radius": shape.size[0], "length": shape.size[1]}
                kind = client.GEOM_CYLINDER
            else:
                geometry, kind = {"radius": shape.size[0]}, client.GEOM_SPHERE
            rgba = [byte / 255.0 for byte in bytes.fromhex(colour[1:].ljust(8, "f"))]
            visual = client.createVisualShape(kind, rgbaColor=rgba, **geometry)
            self._bodies.append(client.createMultiBody(0.0, -1, visual))

    def picture(self, poses: Sequence[Array], view: View) -> NDArray[np.uint8]:
        """Return a picture of the shapes at world poses (7,), shape (360, 480, 3)."""
        client = self._client
        for body, pose in zip(self._bodies, poses, strict=True):
            client.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist())
        position, target = view.position.tolist(), view.target.tolist()
        camera = client.computeViewMatrix(position, target, [0.0, 0.0, 1.0])
        lens = client.computeProjectionMatrixFOV(_FIELD, SIZE[0] / SIZE[1], _NEAR, _FAR)
        image = client.getCameraImage(
            *SIZE, camera, lens, renderer=client.ER_TINY_RENDERER,
            flags=client.ER_NO_SEGMENTATION_MASK,
        )  # fmt: skip
        return np.array(image[2], dtype=np.uint8).reshape(SIZE[1], SIZE[0], 4)[..., :3]

    def close(self) -> None:
        """End the world."""
        self._client.leave()
