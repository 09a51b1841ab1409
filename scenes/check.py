"""What a scene must be: nothing stands within something else, and every handle can be reached."""

from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose, rotation
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.urdf import SLACK, Shape, Urdf, read_moments
from kinfeas.scenes.objects import SceneObject, moving_joint

_THINNEST = 1e-4  # m, of what is left of a shape that is made smaller


class Solids:
    """Shapes in space, looked at as one; not for several threads at once.

    Args:
        shapes: Primitives with their poses in one frame.
        less: How much smaller to take them from side to side, metres: two groups that are taken
            `less` smaller touch where the shapes reach into each other by more than that.
    """

    def __init__(self, shapes: Iterable[Shape], less: float = 0.0) -> None:
        import fcl

        self._fcl = fcl
        self._objects = [_solid(fcl, shape, less) for shape in shapes]
        self._group = fcl.DynamicAABBTreeCollisionManager()
        self._group.registerObjects(self._objects)
        self._group.setup()

    def place(self, rotations: Array, positions: Array) -> None:
        """Move the k shapes, whose poses turn into `rotations` (k, 3, 3) and `positions` (k, 3)."""
        for solid, turn, place in zip(self._objects, rotations, positions, strict=True):
            solid.setTransform(self._fcl.Transform(turn, place))
        self._group.update()

    def touches(self, other: "Solids") -> bool:
        """Return whether any shape touches one of the `other` group."""
        found = self._fcl.CollisionData()
        self._group.collide(other._group, found, self._fcl.defaultCollisionCallback)
        return bool(found.result.is_collision)


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
"""Metres that one object may reach into another one, as where it stands on it."""

HEIGHTS = (0.1, 1.6)
"""Metres above the floor between which robots reach for handles."""

_GRIPPER = (0.1, 0.06, 0.06)  # m, what has to be free in front of a handle
_BEFORE = 0.03  # m, where that begins
_BASE = (0.2, 0.3)  # m, radius and height of the slimmest base
_DISTANCES = np.linspace(0.3, 1.1, 5)  # m, from the handle to the middle of the base
_BEARINGS = np.linspace(-1.2, 1.2, 9)  # rad, away from straight in front of it


def check(
    source: str,
    size: tuple[float, float],
    objects: Mapping[str, SceneObject],
    handles: Mapping[str, Array],
) -> None:
    """Check that no objects overlap and that every handle can be reached.

    Args:
        source: What the error begins with.
        size: Of the floor along x and y, metres.
        objects: What stands there, by name.
        handles: World poses (7,) with x along the approach, by name.

    Raises:
        KinfeasError: If an object stands off or below the floor or within another one, or a
            gripper has no room in front of a handle, or a base none near it.
    """
    check_places(source, size, objects)
    shapes = [shape for one in objects.values() for _, shape in one.shapes()]
    scene = Solids(shapes)
    for name, pose in handles.items():
        _check_handle(f"{source}: handle {name!r} cannot be reached", size, scene, pose)


def check_places(
    source: str, size: tuple[float, float], objects: Mapping[str, SceneObject]
) -> None:
    """Check that all objects stand on the floor and not within each other; arguments as above.

    Raises:
        KinfeasError: If one does not.
    """
    for name, one in objects.items():
        _check_floor(f"{source}: object {name!r}", size, one)
    _check_overlaps(source, objects)


def _check_floor(where: str, size: tuple[float, float], one: SceneObject) -> None:
    if np.any(np.abs(one.pose[:2]) > np.array(size) / 2.0):
        x, y = one.pose[:2]
        raise KinfeasError(
            f"{where} stands at ({x:g}, {y:g}), off the floor of {size[0]:g} x {size[1]:g} m"
        )
    sunk = max((-_lowest(shape) for _, shape in one.shapes()), default=0.0)
    if sunk > OVERLAP:
        raise KinfeasError(f"{where} reaches {sunk:.3g} m below the floor")


def _lowest(shape: Shape) -> float:
    """Return the height of the lowest point of a shape, metres."""
    up = rotation(shape.pose).as_matrix()[2]
    if shape.kind == "box":
        reach = float(np.abs(up) @ np.array(shape.size)) / 2.0
    elif shape.kind == "cylinder":
        radius, length = shape.size
        reach = radius * float(np.hypot(up[0], up[1])) + abs(float(up[2])) * length / 2.0
    else:
        reach = shape.size[0]
    return float(shape.pose[2]) - reach


def _check_overlaps(source: str, objects: Mapping[str, SceneObject]) -> None:
    solids = {
        name: Solids((shape for _, shape in one.shapes()), OVERLAP) for name, one in objects.items()
    }
    for a, b in combinations(objects, 2):
        if solids[a].touches(solids[b]):
            raise KinfeasError(
                f"{source}: objects {a!r} and {b!r} stand within each other, by more than the "
                f"{1000.0 * OVERLAP:g} mm that are allowed"
            )


def _check_handle(where: str, size: tuple[float, float], scene: Solids, pose: Array) -> None:
    if not HEIGHTS[0] <= pose[2] <= HEIGHTS[1]:
        raise KinfeasError(
            f"{where}: its height must be in [{HEIGHTS[0]:g}, {HEIGHTS[1]:g}] m, not {pose[2]:.3g}"
        )
    middle = IDENTITY.copy()
    middle[0] = -_BEFORE - _GRIPPER[0] / 2.0
    if scene.touches(Solids([Shape("box", _GRIPPER, compose(pose, middle))])):
        raise KinfeasError(
            f"{where}: something stands within {_BEFORE + _GRIPPER[0]:g} m before it"
        )
    if not _room_for_a_base(size, scene, pose):
        raise KinfeasError(f"{where}: no base finds room within {_DISTANCES[-1]:g} m before it")


def _room_for_a_base(size: tuple[float, float], scene: Solids, handle: Array) -> bool:
    back = -rotation(handle).as_matrix()[:2, 0]
    heading = np.arctan2(back[1], back[0])
    radius, height = _BASE
    for distance in _DISTANCES:
        for bearing in heading + _BEARINGS:
            place = handle[:2] + distance * np.array([np.cos(bearing), np.sin(bearing)])
            if np.any(np.abs(place) > np.array(size) / 2.0 - radius):
                continue
            # A little above the floor, on which something flat may lie.
            stand = make_pose(np.array([*place, height / 2.0 + 0.01]), Rotation.identity())
            if not scene.touches(Solids([Shape("cylinder", (radius, height), stand)])):
                return True
    return False


def check_inertia(path: Path, urdf: Urdf, *, fixed: bool) -> None:
    """Check that each link that can move has an <inertial> that physics engines can move.

    Args:
        path: The URDF.
        urdf: What it says.
        fixed: Whether its root link stays where it is.

    Raises:
        KinfeasError: If it has none, or no mass, or moments that no body has.
    """
    robot = read_xml(path, "robot")
    hangs = {joint.child for joint in urdf.joints.values() if not joint.moves}
    for link in robot.children("link"):
        name = link.text("name")
        if fixed and moving_joint(urdf, name) is None:
            continue
        named, inertial = Element(link.xml, f"{path}: link {name!r}"), link.child("inertial")
        if inertial is None:
            raise named.error("it can move, and <inertial> is missing")
        if urdf.links[name].mass > 0.0:
            _check_moments(named, read_moments(inertial.need("inertia")))
        elif name not in hangs:  # a frame may hang on what has a mass
            raise named.error("it can move, and its mass must be above 0")


def _check_moments(link: Element, moments: Array) -> None:
    small, middle, large = np.linalg.eigvalsh(moments)
    if small <= 0.0:
        raise link.error("it can move, and all principal moments of inertia must be above 0")
    if large - small - middle > SLACK * large:
        raise link.error(
            f"it can move, and its largest principal moment of inertia, {large:.3g}, must be at "
            f"most the sum of the other two, {small + middle:.3g}"
        )
