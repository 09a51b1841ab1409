"""The furniture of a scene as solids, for IK, scans and filters, and for worlds without physics."""

import numpy as np

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import rotation
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.objects import SceneObject, moving_joint
from kinfeas.scenes.scene import Scene

_UPRIGHT = 1.0 - 1e-6  # smallest vertical part of the z axis of an upright shape


def furniture_solids(scene: Scene, grasped: tuple[str, str] | None = None) -> Solids:
    """Return the collision shapes of fixed objects as one row of solids.

    Upright boxes around them stand for shapes that are not upright. Movable objects are left out,
    and so are the links that move with the `grasped` one, an object and its link: solids do not
    turn.
    """
    lines = []
    for name, scene_object in scene.objects.items():
        moved = (
            _moved_with(scene_object, grasped[1]) if grasped and grasped[0] == name else frozenset()
        )
        if scene_object.fixed:
            lines += [_line(shape) for link, shape in scene_object.shapes() if link not in moved]
    solids = Solids.empty(1, len(lines))
    for index, (pose, size, cylinder) in enumerate(lines):
        solids.pose[0, index], solids.size[0, index] = pose, size
        solids.cylinder[0, index] = cylinder
    return solids


def _moved_with(scene_object: SceneObject, link: str) -> frozenset[str]:
    """Return the links that the nearest moving joint above a link carries."""
    joint = moving_joint(scene_object.urdf, link)
    return frozenset() if joint is None else scene_object.urdf.below(joint)


def _line(shape: Shape) -> tuple[list[float], list[float], bool]:
    """Return pose and size of a solid, and whether it is a cylinder, as in `Solids`."""
    high, low = (np.array([shape.reach(side) for side in sign * np.eye(3)]) for sign in (1, -1))
    heights = [-low[2], high[2]]
    half, heading = (high + low)[:2] / 2.0, 0.0
    matrix = rotation(shape.pose).as_matrix()
    upright = abs(matrix[2, 2]) >= _UPRIGHT
    if shape.kind == "box" and upright:  # also upside down
        half, heading = (
            np.array(shape.size[:2]) / 2.0,
            float(np.arctan2(matrix[1, 0], matrix[0, 0])),
        )
    cylinder = shape.kind == "sphere" or (shape.kind == "cylinder" and upright)
    return [*shape.pose[:2], heading], [*half, *heights], cylinder
