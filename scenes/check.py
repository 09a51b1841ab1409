"""Checks of a scene: places, overlaps, reachable handles and inertias; collisions by python-fcl."""

from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose, rotation
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

    def position(self, rotations: Array, positions: Array) -> None:
        """Move the k shapes to orientations (k, 3, 3) and positions (k, 3)."""
        for solid, orientation, position in zip(self._objects, rotations, positions, strict=True):
            solid.setTransform(self._fcl.Transform(orientation, position))
        self._group.update()

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


OVERLAP = 1e-3
"""Metres by which two objects may overlap, as where one is on the other."""

HEIGHTS = (0.1, 1.6)
"""Allowed heights of handles, metres."""

_GRIPPER = (0.1, 0.06, 0.06)  # m, box that must be free in front of a handle
_BEFORE = 0.03  # m, from the handle to that box
_BASE = (0.2, 0.3)  # m, radius and height of a small base
_DISTANCES = np.linspace(0.3, 1.1, 5)  # m, from the handle to the base
_BEARINGS = np.linspace(-1.2, 1.2, 9)  # rad, from the handle's normal


def check(
    source: str,
    size: tuple[float, float],
    objects: Mapping[str, SceneObject],
    handles: Mapping[str, Array],
) -> None:
    """Check that objects are on the floor without overlap and that every handle can be reached.

    A handle needs room for a gripper in front of it and for a base near it.

    Args:
        source: File name for errors.
        size: Size of the floor along x and y, metres.
        objects: Objects by name.
        handles: World poses (7,) with x along the approach, by name.
    """
    check_places(source, size, objects)
    shapes = [shape for scene_object in objects.values() for _, shape in scene_object.shapes()]
    scene = ShapeGroup(shapes)
    for name, pose in handles.items():
        _check_handle(f"{source}: handle {name!r} cannot be reached", size, scene, pose)


def check_places(
    source: str, size: tuple[float, float], objects: Mapping[str, SceneObject]
) -> None:
    """Check that all objects are on the floor and do not overlap; arguments and errors as above."""
    for name, scene_object in objects.items():
        _check_floor(f"{source}: object {name!r}", size, scene_object)
    _check_overlaps(source, objects)


def _check_floor(where: str, size: tuple[float, float], scene_object: SceneObject) -> None:
    if np.any(np.abs(scene_object.pose[:2]) > np.array(size) / 2.0):
        x, y = scene_object.pose[:2]
        raise KinfeasError(
            f"{where} is at ({x:g}, {y:g}), off the floor of {size[0]:g} x {size[1]:g} m"
        )
    sunk = max((shape.reach(_DOWN) for _, shape in scene_object.shapes()), default=0.0)
    if sunk > OVERLAP:
        raise KinfeasError(f"{where} is {sunk:.3g} m below the floor")


def _check_overlaps(source: str, objects: Mapping[str, SceneObject]) -> None:
    solids = {
        name: ShapeGroup((shape for _, shape in scene_object.shapes()), OVERLAP)
        for name, scene_object in objects.items()
    }
    for a, b in combinations(objects, 2):
        if solids[a].touches(solids[b]):
            raise KinfeasError(
                f"{source}: objects {a!r} and {b!r} overlap by more than {1000.0 * OVERLAP:g} mm"
            )


def _check_handle(where: str, size: tuple[float, float], scene: ShapeGroup, pose: Array) -> None:
    if not HEIGHTS[0] <= pose[2] <= HEIGHTS[1]:
        raise KinfeasError(
            f"{where}: its height must be in [{HEIGHTS[0]:g}, {HEIGHTS[1]:g}] m, not {pose[2]:.3g}"
        )
    middle = IDENTITY.copy()
    middle[0] = -_BEFORE - _GRIPPER[0] / 2.0
    if scene.touches(ShapeGroup([Shape("box", _GRIPPER, compose(pose, middle))])):
        raise KinfeasError(
            f"{where}: there is an object within {_BEFORE + _GRIPPER[0]:g} m in front of it"
        )
    if not _room_for_a_base(size, scene, pose):
        raise KinfeasError(
            f"{where}: there is no room for a base within {_DISTANCES[-1]:g} m in front of it"
        )


def _room_for_a_base(size: tuple[float, float], scene: ShapeGroup, handle: Array) -> bool:
    back = -rotation(handle).as_matrix()[:2, 0]
    heading = np.arctan2(back[1], back[0])
    radius, height = _BASE
    for distance in _DISTANCES:
        for bearing in heading + _BEARINGS:
            place = handle[:2] + distance * np.array([np.cos(bearing), np.sin(bearing)])
            if np.any(np.abs(place) > np.array(size) / 2.0 - radius):
                continue
            # 1 cm above the floor, so that flat objects do not count.
            stand = make_pose(np.array([*place, height / 2.0 + 0.01]), Rotation.identity())
            if not scene.touches(ShapeGroup([Shape("cylinder", (radius, height), stand)])):
                return True
    return False


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
