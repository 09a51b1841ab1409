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
    for name, one in scene.objects.items():
        moved = _moved_with(one, grasped[1]) if grasped and grasped[0] == name else frozenset()
        if one.fixed:
            lines += [_line(shape) for link, shape in one.shapes() if link not in moved]
    solids = Solids.empty(1, len(lines))
    for place, (pose, size, cylinder) in enumerate(lines):
        solids.pose[0, place], solids.size[0, place] = pose, size
        solids.cylinder[0, place] = cylinder
    return solids


def _moved_with(one: SceneObject, link: str) -> frozenset[str]:
    """Return the links that the nearest moving joint above a link carries."""
    joint = moving_joint(one.urdf, link)
    return frozenset() if joint is None else one.urdf.below(joint)


def _line(shape: Shape) -> tuple[list[float], list[float], bool]:
    """Return pose and size of a solid, and whether it is a cylinder, as in `Solids`."""
    high, low = (np.array([shape.reach(side) for side in sign * np.eye(3)]) for sign in (1, -1))
    heights = [-low[2], high[2]]
    half, heading = (high + low)[:2] / 2.0, 0.0
    turn = rotation(shape.pose).as_matrix()
    upright = abs(turn[2, 2]) >= _UPRIGHT
    if shape.kind == "box" and upright:  # also upside down
        half, heading = np.array(shape.size[:2]) / 2.0, float(np.arctan2(turn[1, 0], turn[0, 0]))
    cylinder = shape.kind == "sphere" or (shape.kind == "cylinder" and upright)
    return [*shape.pose[:2], heading], [*half, *heights], cylinder
