"""A URDF file as a checked tree of links and joints."""

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, Protocol, TypeVar, cast, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import FARTHEST
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, compose, make_pose
from kinfeas.robots.elements import Element, read_xml

MAX_DEPTH = 200
"""Joints between the root and a link, or that follow one another: more than any robot has."""

ShapeKind = Literal["box", "cylinder", "sphere"]
JointKind = Literal["fixed", "revolute", "continuous", "prismatic"]


@dataclass(frozen=True, eq=False)
class Shape:
    """A primitive that stands for part of a link in collision checks.

    Attributes:
        kind: Which primitive it is.
        size: Box: full x, y and z; cylinder: radius and length along z; sphere: radius. Metres.
        pose: Pose of its centre in the link's frame, shape (7,).
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose: Array


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body.

    Attributes:
        name: Unique name.
        mass: Kilograms, 0 for a mere frame.
        shapes: Primitives of its collision geometry.
        mesh_collisions: Whether it has collision meshes besides, which are not read.
    """

    name: str
    mass: float
    shapes: tuple[Shape, ...]
    mesh_collisions: bool


@dataclass(frozen=True)
class Mimic:
    """The joint that another one follows: position = multiplier * position of joint + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """What holds a link to its parent; radians for turning joints, metres for sliding ones.

    Attributes:
        name: Unique name.
        kind: How it moves.
        parent: Link that it stands on.
        child: Link that it moves.
        origin: Pose of the child in the parent's frame at position 0, shape (7,).
        axis: Unit vector in the joint's frame.
        lower: Hard lower limit; -inf for a continuous joint, 0 for a fixed one.
        upper: Hard upper limit; inf for a continuous joint, 0 for a fixed one.
        soft_lower: Lower limit of the safety controller, the hard one if it gives none.
        soft_upper: Upper limit of the safety controller, the hard one if it gives none.
        velocity: Largest speed, per second; inf for a continuous joint without a limit.
        effort: Largest force or torque, N or N m; inf where none is given.
        damping: N s/m or N m s/rad.
        friction: N or N m.
        mimic: The joint that it follows, or None.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    origin: Array
    axis: tuple[float, float, float]
    lower: float
    upper: float
    soft_lower: float
    soft_upper: float
    velocity: float
    effort: float
    damping: float
    friction: float
    mimic: Mimic | None

    @property
    def moves(self) -> bool:
        """Whether the joint has a position."""
        return self.kind != "fixed"

    def pose_at(self, position: float) -> Array:
        """Return the pose of the child in the parent's frame at `position`, shape (7,)."""
        return compose(self.origin, self.motion_at(position))

    def motion_at(self, position: float) -> Array:
        """Return the pose of the child at `position`, seen from its `origin`, shape (7,)."""
        along = position * np.array(self.axis)
        if self.kind == "prismatic":
            return make_pose(along, Rotation.identity())
        return make_pose(np.zeros(3), Rotation.from_rotvec(along))


@dataclass(frozen=True, eq=False)
class Urdf:
    """A tree of links, held together by joints.

    Attributes:
        name: Name of the robot.
        links: Links by name, in the file's order.
        joints: Joints by name, in the file's order.
        root: The one link without a parent.
    """

    name: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    root: str

    @cached_property
    def on(self) -> dict[str, list[Joint]]:
        """The joints right on each link, in the file's order."""
        found: dict[str, list[Joint]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            found[joint.parent].append(joint)
        return found

    @cached_property
    def rigid(self) -> dict[str, frozenset[str]]:
        """The links that cannot move against each link, itself included."""
        found: dict[str, frozenset[str]] = {}
        for base in (self.root, *(joint.child for joint in self.joints.values() if joint.moves)):
            group = [base]
            for link in group:
                group += [joint.child for joint in self.on[link] if not joint.moves]
            found |= dict.fromkeys(group, frozenset(group))
        return found

    @cached_property
    def _above(self) -> dict[str, Joint]:
        return {joint.child: joint for joint in self.joints.values()}

    def path_to(self, link: str) -> tuple[Joint, ...]:
        """Return the joints, fixed ones too, that lead from the root to `link`."""
        path = []
        while link != self.root:
            path.append(self._above[link])
            link = path[-1].parent
        return tuple(reversed(path))

    def below(self, joint: str) -> frozenset[str]:
        """Return the links that the joint of this name carries."""
        found = [self.joints[joint].child]
        for link in found:
            found += [one.child for one in self.on[link]]
        return frozenset(found)

    def followed(self, joint: Joint) -> tuple[Joint, float, float]:
        """Return the joint that `joint` follows in the end, or itself, with scale and offset.

        The position of `joint` is scale * position of that one + offset.
        """
        scale, offset = 1.0, 0.0
        while joint.mimic is not None:
            offset += scale * joint.mimic.offset
            scale *= joint.mimic.multiplier
            joint = self.joints[joint.mimic.joint]
        return joint, scale, offset


def find_root(links: Collection[str], joints: Iterable[Joint], source: str) -> str:
    """Return the one link without a parent.

    Args:
        links: Names of all links.
        joints: What joins them.
        source: File name for the error.

    Raises:
        KinfeasError: If a joint names an unknown link, a link hangs on two joints, links and
            joints do not form one tree, or it is deeper than `MAX_DEPTH`.
    """
    parents: dict[str, str] = {}
    for joint in joints:
        where = f"{source}: joint {joint.name!r}"
        for link in (joint.parent, joint.child):
            if link not in links:
                raise KinfeasError(f"{where}: there is no link {link!r}")
        if joint.child in parents:
            raise KinfeasError(f"{where}: link {joint.child!r} hangs on another joint, too")
        parents[joint.child] = joint.parent
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        raise KinfeasError(f"{source}: one root link is allowed, not {', '.join(roots)}")
    depth = _depths(roots, parents)
    if lost := set(links) - depth.keys():
        raise KinfeasError(f"{source}: link {min(lost)!r} hangs on a closed loop of joints")
    if not roots:
        raise KinfeasError(f"{source}: there is no <link>")
    deepest = max(depth, key=depth.__getitem__)
    if depth[deepest] > MAX_DEPTH:
        raise KinfeasError(
            f"{source}: link {deepest!r} is {depth[deepest]} joints away from the root, at most "
            f"{MAX_DEPTH} are allowed"
        )
    return roots[0]


def _depths(roots: Iterable[str], parents: Mapping[str, str]) -> dict[str, int]:
    """Return how many joints `roots` and all links below them are away from the roots."""
    children: dict[str, list[str]] = {}
    for child, parent in parents.items():
        children.setdefault(parent, []).append(child)
    found = dict.fromkeys(roots, 0)
    todo = list(found)
    for link in todo:
        below = children.get(link, [])
        found |= dict.fromkeys(below, found[link] + 1)
        todo += below
    return found


def check_mimics(joints: Mapping[str, Joint], source: str) -> None:
    """Check that every joint that follows another one ends up at one that moves by itself.

    Raises:
        KinfeasError: If a joint follows an unknown or a fixed joint, in the end itself, or over
            more than `MAX_DEPTH` others.
    """
    for name, joint in joints.items():
        where, seen, mimic = f"{source}: joint {name!r}, <mimic>", {name}, joint.mimic
        while mimic is not None:
            if mimic.joint not in joints or not joints[mimic.joint].moves:
                raise KinfeasError(f"{where}: there is no moving joint {mimic.joint!r}")
            if mimic.joint in seen:
                raise KinfeasError(f"{where}: the joint follows itself")
            if len(seen) > MAX_DEPTH:
                raise KinfeasError(f"{where}: at most {MAX_DEPTH} joints may follow one another")
            seen.add(mimic.joint)
            mimic = joints[mimic.joint].mimic


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

MOMENTS = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}
"""Attributes of <inertia>, and where they stand in the matrix."""

SLACK = 1e-6
"""Share of a moment that is no more than a rounding."""

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


def read_moments(inertia: Element) -> Array:
    """Return the moments that an element <inertia> says, shape (3, 3), kg m^2."""
    moments = np.zeros((3, 3))
    for name, (row, column) in MOMENTS.items():
        moments[row, column] = moments[column, row] = inertia.number(name, 0.0)
    return moments
