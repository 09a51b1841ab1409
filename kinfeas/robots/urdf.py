"""A URDF file as a checked tree of links and joints."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol, TypeVar, cast, get_args

import numpy as np

from kinfeas.config.quantities import FARTHEST
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.elements import Element, read_xml
from kinfeas.robots.tree import (
    Joint,
    JointKind,
    Link,
    Mimic,
    Shape,
    ShapeKind,
    Urdf,
    check_mimics,
    find_root,
)

__all__ = [
    "Joint",
    "JointKind",
    "Link",
    "Mimic",
    "Shape",
    "ShapeKind",
    "Urdf",
    "parse_urdf",
    "urdf_of",
]

_HEAVIEST, _MOST_INERTIA = 1e5, 1e7  # kg and kg m^2


def parse_urdf(path: Path) -> Urdf:
    """Return the robot that a URDF file describes.

    Raises:
        KinfeasError: If the file cannot be read, is not XML or no tree of supported joints, or
            holds a number that is missing, not finite or out of its range.
    """
    return urdf_of(read_xml(path, "robot"))


def urdf_of(robot: Element) -> Urdf:
    """Return the robot that an element <robot> describes; errors as in `parse_urdf`."""
    links = _by_name(robot, "link", _link)
    joints = _by_name(robot, "joint", _joint)
    root = find_root(links, joints.values(), robot.where)
    check_mimics(joints, robot.where)
    urdf = Urdf(robot.text("name"), links, joints, root)
    for joint in joints.values():
        _check_following(urdf, joint, robot.where)
    return urdf


class _Named(Protocol):
    @property
    def name(self) -> str: ...


_N = TypeVar("_N", bound=_Named)


def _by_name(robot: Element, tag: str, read: Callable[[Element], _N]) -> dict[str, _N]:
    found: dict[str, _N] = {}
    for element in robot.children(tag):
        name = element.text("name")
        named = Element(element.xml, f"{robot.where}: {tag} {name!r}")
        if name in found:
            raise named.error(f"there are two {tag}s of this name")
        found[name] = read(named)
    return found


def _link(element: Element) -> Link:
    # A physics engine reads these elsewhere, from the same file: they are checked here for it.
    _shapes(element.children("visual"))
    collisions = element.children("collision")
    shapes = tuple(_shapes(collisions))
    return Link(element.text("name"), _mass(element), shapes, len(shapes) < len(collisions))


def _mass(link: Element) -> float:
    inertial = link.child("inertial")
    if inertial is None:
        return 0.0
    inertial.origin()
    inertia = inertial.need("inertia")
    for product in ("ixy", "ixz", "iyz"):
        inertia.number(product, 0.0, _MOST_INERTIA)
    for moment in ("ixx", "iyy", "izz"):
        inertia.not_negative(moment, most=_MOST_INERTIA)
    return inertial.need("mass").not_negative("value", most=_HEAVIEST)


def _shapes(elements: Iterable[Element]) -> list[Shape]:
    return [shape for shape in map(read_shape, elements) if shape]


def read_shape(element: Element) -> Shape | None:
    """Return the primitive of a <visual> or <collision>, or None if it is a mesh."""
    pose, geometry = element.origin(), element.need("geometry")
    if box := geometry.child("box"):
        return Shape("box", box.positive("size", 3), pose)
    if cylinder := geometry.child("cylinder"):
        size = (*cylinder.positive("radius"), *cylinder.positive("length"))
        return Shape("cylinder", size, pose)
    if sphere := geometry.child("sphere"):
        return Shape("sphere", sphere.positive("radius"), pose)
    if mesh := geometry.child("mesh"):
        mesh.text("filename")
        mesh.vector("scale", 3, (1.0, 1.0, 1.0))
        return None
    raise geometry.error("must hold a <box>, <cylinder>, <sphere> or <mesh>")


def _joint(element: Element) -> Joint:
    kind = element.text("type")
    if kind not in get_args(JointKind):
        raise element.error(f"type must be one of {', '.join(get_args(JointKind))}, not {kind!r}")
    lower, upper = _limits(element, kind)
    soft_lower, soft_upper = _soft_limits(element, kind, lower, upper)
    velocity, effort = _rates(element, kind)
    damping, friction = _dynamics(element)
    return Joint(
        name=element.text("name"),
        kind=cast("JointKind", kind),
        parent=element.need("parent").text("link"),
        child=element.need("child").text("link"),
        origin=element.origin(),
        axis=_axis(element, kind),
        lower=lower,
        upper=upper,
        soft_lower=soft_lower,
        soft_upper=soft_upper,
        velocity=velocity,
        effort=effort,
        damping=damping,
        friction=friction,
        mimic=_mimic(element, kind),
    )


def _limits(joint: Element, kind: str) -> tuple[float, float]:
    if kind == "fixed":
        return 0.0, 0.0
    if kind == "continuous":
        return -math.inf, math.inf
    limit = joint.need("limit")
    lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    if lower > upper:
        raise limit.error(f"'lower' is {lower:g}, above 'upper', which is {upper:g}")
    return lower, upper


def _soft_limits(joint: Element, kind: str, lower: float, upper: float) -> tuple[float, float]:
    safety = joint.child("safety_controller")
    if safety is None or kind in ("fixed", "continuous"):
        return lower, upper
    soft_lower = safety.number("soft_lower_limit", lower)
    soft_upper = safety.number("soft_upper_limit", upper)
    if not lower <= soft_lower <= soft_upper <= upper:
        raise safety.error(
            f"soft limits {soft_lower:g} to {soft_upper:g} must lie in {lower:g} to {upper:g}"
        )
    return soft_lower, soft_upper


def _rates(joint: Element, kind: str) -> tuple[float, float]:
    """Return the largest velocity and effort."""
    if kind == "fixed":
        return 0.0, 0.0
    limit = joint.child("limit")
    if limit is None:  # only a continuous joint comes here without one
        return math.inf, math.inf
    return limit.not_negative("velocity", 0.0), limit.not_negative("effort", math.inf)


def _dynamics(joint: Element) -> tuple[float, float]:
    """Return damping and friction."""
    dynamics = joint.child("dynamics")
    if dynamics is None:
        return 0.0, 0.0
    return dynamics.not_negative("damping", 0.0), dynamics.not_negative("friction", 0.0)


def _axis(joint: Element, kind: str) -> tuple[float, float, float]:
    element, default = joint.child("axis"), (1.0, 0.0, 0.0)
    if element is None or kind == "fixed":  # for which exporters write 0 0 0
        return default
    axis = np.array(element.vector("xyz", 3, default))
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise joint.error("the axis must not be zero")
    x, y, z = (axis / length).tolist()
    return x, y, z


def _check_following(urdf: Urdf, joint: Joint, source: str) -> None:
    _, scale, offset = urdf.followed(joint)
    if not (abs(scale) <= FARTHEST and abs(offset) <= FARTHEST):
        raise KinfeasError(
            f"{source}: joint {joint.name!r}, <mimic>: 'multiplier' and 'offset' must be at most "
            f"{FARTHEST:g} in size, together with those of the joints that it follows"
        )


def _mimic(joint: Element, kind: str) -> Mimic | None:
    element = joint.child("mimic")
    if element is None or kind == "fixed":
        return None
    return Mimic(
        element.text("joint"), element.number("multiplier", 1.0), element.number("offset", 0.0)
    )
