"""Pictures of shapes, drawn by PyBullet on the processor."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.camera import FAR, FIELD, NEAR, SIZE, View, rgba
from kinfeas.backends.pybullet.physics import connect
from kinfeas.core.spatial import Array
from kinfeas.robots.urdf import Shape


class PyBulletCamera:
    """Shapes in a PyBullet world of their own, without physics."""

    def __init__(self, shapes: Sequence[tuple[Shape, str]]) -> None:
        """Draw shapes with colours, `#rrggbb` or `#rrggbbaa`."""
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
            visual = client.createVisualShape(kind, rgbaColor=rgba(colour), **geometry)
            self._bodies.append(client.createMultiBody(0.0, -1, visual))

    def picture(self, poses: Sequence[Array], view: View) -> NDArray[np.uint8]:
        """Return a picture of the shapes at world poses (7,), shape (360, 480, 3)."""
        client = self._client
        for body, pose in zip(self._bodies, poses, strict=True):
            client.resetBasePositionAndOrientation(body, pose[:3].tolist(), pose[3:].tolist())
        camera = client.computeViewMatrix(
            view.position.tolist(), view.target.tolist(), [0.0, 0.0, 1.0]
        )
        lens = client.computeProjectionMatrixFOV(FIELD, SIZE[0] / SIZE[1], NEAR, FAR)
        image = client.getCameraImage(
            *SIZE, camera, lens, renderer=client.ER_TINY_RENDERER,
            flags=client.ER_NO_SEGMENTATION_MASK,
        )  # fmt: skip
        return np.array(image[2], dtype=np.uint8).reshape(SIZE[1], SIZE[0], 4)[..., :3]

    def close(self) -> None:
        """End the world."""
        self._client.leave()
