"""Checks of a scene: positions, overlaps by python-fcl, and inertias."""

from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.urdf import Shape, Urdf
from kinfeas.robots.urdf_file import SLACK, read_moments
from kinfeas.scenes.objects import SceneObject, moving_joint

_DOWN = np.array([0.0, 0.0, -1.0])
_THINNEST = 1e-4  # m, of a shrunk shape


class ShapeGroup:
    """A group of shapes for collision checks; not thread-safe.

    Args:
        shapes: Primitives with their poses in one frame.
        less: Metres by which each shape is shrunk in total along each axis. Two groups that are
            shrunk by `less` touch where their shapes overlap by more than that.
    """

    def __init__(self, shapes: Iterable[Shape], less: float = 0.0) -> None:
        import fcl

        self._fcl = fcl
        self._objects = [_solid(fcl, shape, less) for shape in shapes]
        self._group = fcl.DynamicAABBTreeCollisionManager()
        self._group.registerObjects(self._objects)
        self._group.setup()

    def touches(self, other: "ShapeGroup") -> bool:
        """Return whether any shape touches one of the `other` group."""
        data = self._fcl.CollisionData()
        self._group.collide(other._group, data, self._fcl.defaultCollisionCallback)
        return bool(data.result.is_collision)


def _solid(fcl: Any, shape: Shape, less: float) -> Any:
    kinds = {"box": fcl.Box, "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}
    thinner = {"box": (less,) * 3, "cylinder": (less / 2.0, less), "sphere": (less / 2.0,)}
    size = [
        max(full - part, _THINNEST)
        for full, part in zip(shape.size, thinner[shape.kind], strict=True)
    ]
    placed = fcl.Transform(rotation(shape.pose).as_matrix(), shape.pose[:3])
    return fcl.CollisionObject(kinds[shape.kind](*size), placed)


OVERLAP = 1e-3  # metres by which two objects may overlap, as where one is on the other


def check_places(
    source: str, size: tuple[float, float], objects: Mapping[str, SceneObject]
) -> None:
    """Raise an error unless objects are on a floor of some size, metres, and do not overlap."""
    for name, scene_object in objects.items():
        where, (x, y) = f"{source}: object {name!r}", scene_object.pose[:2]
        if abs(x) > size[0] / 2.0 or abs(y) > size[1] / 2.0:
            raise KinfeasError(
                f"{where} is at ({x:g}, {y:g}), off the floor of {size[0]:g} x {size[1]:g} m"
            )
        sunk = max((shape.reach(_DOWN) for _, shape in scene_object.shapes()), default=0.0)
        if sunk > OVERLAP:
            raise KinfeasError(f"{where} is {sunk:.3g} m below the floor")
    solids = {
        name: ShapeGroup((shape for _, shape in scene_object.shapes()), OVERLAP)
        for name, scene_object in objects.items()
    }
    for a, b in combinations(objects, 2):
        if solids[a].touches(solids[b]):
            raise KinfeasError(
                f"{source}: objects {a!r} and {b!r} overlap by more than {1000.0 * OVERLAP:g} mm"
            )


def check_inertia(path: Path, urdf: Urdf, *, fixed: bool) -> None:
    """Check that each link that can move has a mass and plausible moments of inertia.

    `fixed` is whether the root link of the URDF at `path` is fixed to the world.
    """
    robot = read_xml(path, "robot")
    attached = {joint.child for joint in urdf.joints.values() if not joint.moves}
    for link in robot.children("link"):
        name = link.text("name")
        if fixed and moving_joint(urdf, name) is None:
            continue
        named, inertial = Element(link.xml, f"{path}: link {name!r}"), link.child("inertial")
        if inertial is None:
            raise named.error("a moving link needs <inertial>")
        if urdf.links[name].mass > 0.0:
            _check_moments(named, read_moments(inertial.need("inertia")))
        elif name not in attached:  # frames on a link with mass need none
            raise named.error("a moving link needs a mass above 0")


def _check_moments(link: Element, moments: Array) -> None:
    small, middle, large = np.linalg.eigvalsh(moments)
    if small <= 0.0:
        raise link.error("all principal moments of inertia must be above 0")
    if large - small - middle > SLACK * large:
        raise link.error(
            f"the largest principal moment of inertia, {large:.3g}, must be at most the sum of the "
            f"other two, {small + middle:.3g}"
        )
