"""Pictures of shapes, drawn by MuJoCo with OpenGL."""

import os
import sys
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.camera import FAR, FIELD, NEAR, SIZE, View, rgba
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.urdf import Shape

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
_BACKGROUND = [1.0, 1.0, 1.0]


class MuJoCoCamera:
    """Shapes in a MuJoCo model of their own, without physics."""

    def __init__(self, shapes: Sequence[tuple[Shape, str]]) -> None:
        """Draw shapes with colours, `#rrggbb` or `#rrggbbaa`."""
        spec = mujoco.MjSpec()
        spec.visual.global_.fovy = FIELD
        spec.stat.extent, spec.visual.map.znear, spec.visual.map.zfar = 1.0, NEAR, FAR
        spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.6] * 3, [0.4] * 3
        spec.add_texture(
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=8, height=8,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=_BACKGROUND,
        )  # fmt: skip
        for shape, colour in shapes:
            size = [*shape.size]
            if shape.kind == "box":
                size = [side / 2.0 for side in size]
            elif shape.kind == "cylinder":
                size[1] /= 2.0
            size += [0.0] * (3 - len(size))
            body = spec.worldbody.add_body(mocap=True)
            body.add_geom(type=_KINDS[shape.kind], size=size, rgba=rgba(colour))
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._renderer = _renderer(self._model)

    def picture(self, poses: Sequence[Array], view: View) -> NDArray[np.uint8]:
        """Return a picture of the shapes at world poses (7,), shape (360, 480, 3)."""
        for number, pose in enumerate(poses):
            self._data.mocap_pos[number] = pose[:3]
            self._data.mocap_quat[number] = np.roll(pose[3:], 1)
        mujoco.mj_kinematics(self._model, self._data)
        camera = mujoco.MjvCamera()
        camera.lookat, camera.distance = view.target, view.distance
        camera.azimuth, camera.elevation = np.rad2deg([view.heading, -view.elevation])
        self._renderer.update_scene(self._data, camera)
        image: NDArray[np.uint8] = self._renderer.render()
        return image

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def _renderer(model: Any) -> Any:
    """Return a renderer, which draws by EGL where there is no screen."""
    try:
        if sys.platform == "linux" and not {"DISPLAY", "MUJOCO_GL"} & os.environ.keys():
            from mujoco.egl import GLContext
            from mujoco.rendering.classic import gl_context

            gl_context.GLContext = GLContext  # was chosen when MuJoCo was imported
        return mujoco.Renderer(model, SIZE[1], SIZE[0])
    except Exception as error:
        raise KinfeasError(f"MuJoCo finds no OpenGL: {error}") from error
