"""Pictures of shapes at poses that the caller sets, drawn by an engine."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.config.recipes import default_engine
from kinfeas.core.extras import require
from kinfeas.core.spatial import Array
from kinfeas.robots.urdf import Shape

SIZE = (480, 360)
"""Width and height of a picture in pixels."""

FIELD = 40.0
"""Vertical field of view, degrees."""

NEAR, FAR = 0.05, 50.0
"""Distances from the camera between which things are drawn, metres."""

_TANGENTS = np.tan(np.deg2rad(FIELD) / 2.0) * np.array([SIZE[0] / SIZE[1], 1.0])


@dataclass(frozen=True, eq=False)
class View:
    """Position and direction of a camera.

    Attributes:
        target: World position in the middle of the picture, shape (3,).
        distance: From the camera to the target, metres.
        heading: World direction in which the camera looks, radians.
        elevation: Angle by which it looks down, radians.
    """

    target: Array
    distance: float
    heading: float
    elevation: float

    @staticmethod
    def of_box(low: Array, high: Array, heading: float, elevation: float) -> "View":
        """Return the nearest view in a direction that shows a box with two corners, (3,) each."""
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
        """Return where world points (k, 3) are in the picture, shape (k, 2): right and down."""
        ahead, right, up = self.axes @ (points - self.position).T
        across = np.stack([right, -up], axis=1) / np.maximum(ahead, 1e-3)[:, np.newaxis]
        return (1.0 + across / _TANGENTS) * np.array(SIZE) / 2.0


class Camera(Protocol):
    """An engine that draws the shapes with which it was opened."""

    def picture(self, poses: Sequence[Array], view: View) -> NDArray[np.uint8]:
        """Return a picture of the shapes at world poses (7,), shape (360, 480, 3)."""
        ...

    def close(self) -> None:
        """End the engine."""
        ...


def open_camera(shapes: Sequence[tuple[Shape, str]]) -> Camera:
    """Return a camera for shapes with colours, `#rrggbb` or `#rrggbbaa`.

    PyBullet draws without a graphics card; MuJoCo, which needs OpenGL, draws where PyBullet is not
    installed. Poses of the shapes are those given to `Camera.picture`.

    Raises:
        KinfeasError: If no engine is installed, or MuJoCo finds no OpenGL.
    """
    engine = default_engine()
    require(engine)
    if engine == "pybullet":
        from kinfeas.backends.pybullet.camera import PyBulletCamera

        return PyBulletCamera(shapes)
    from kinfeas.backends.mujoco.camera import MuJoCoCamera

    return MuJoCoCamera(shapes)


def rgba(colour: str) -> list[float]:
    """Return a colour, `#rrggbb` or `#rrggbbaa`, as four fractions."""
    return [byte / 255.0 for byte in bytes.fromhex(colour[1:].ljust(8, "f"))]
