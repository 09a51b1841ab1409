"""URDF files: a checked tree of links and joints."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import FARTHEST
from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose
from kinfeas.robots.elements import Element, read_xml

ShapeKind = Literal["box", "cylinder", "sphere"]
JointKind = Literal["fixed", "revolute", "continuous", "prismatic"]

MOMENTS = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
"""Attributes of <inertia>, and their row and column."""

SLACK = 1e-6
"""Share of a principal moment that counts as rounding."""

_MAX_MASS, _MAX_MOMENT = 1e5, 1e7  # kg and kg m^2


@dataclass(frozen=True, eq=False)
class Shape:
    """A primitive of a link's collision geometry.

    Attributes:
        kind: Kind of primitive.
        size: Box: full x, y and z; cylinder: radius and length along z; sphere: radius. Metres.
        pose: Pose of its centre in the link's frame, shape (7,).
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose: Array

    def reach(self, direction: Array) -> float:
        """Return the largest coordinate along `direction`, a unit vector (3,), metres."""
        along = Rotation.from_quat(self.pose[3:]).inv().apply(direction)
        middle = float(self.pose[:3] @ direction)
        if self.kind == "box":
            return middle + float(np.abs(along) @ np.array(self.size)) / 2.0
        if self.kind == "cylinder":
            radius, length = self.size
            return middle + radius * float(np.hypot(*along[:2])) + abs(along[2]) * length / 2.0
        return middle + self.size[0]


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body with a mass in kg (0 for a frame without inertia) and collision primitives.

    `mesh_collisions` is whether it also has collision meshes, which are not read.
    """

    name: str
    mass: float
    shapes: tuple[Shape, ...]
    mesh_collisions: bool


@dataclass(frozen=True)
class Mimic:
    """A coupling to another joint: position = multiplier * position of `joint` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint; positions are radians, or metres if it is prismatic.

    Attributes:
        origin: Pose of the child in the parent's frame at position 0, shape (7,).
        axis: Unit vector in the joint's frame.
        lower: Hard lower limit; -inf for a continuous joint, 0 for a fixed one.
        upper: Hard upper limit; inf for a continuous joint, 0 for a fixed one.
        soft_lower: Lower limit of the safety controller, by default the hard one.
        soft_upper: Upper limit of the safety controller, by default the hard one.
        velocity: Velocity limit, per second; inf for a continuous joint without a limit.
        effort: Effort limit, N or N m; inf where none is given.
        damping: N s/m or N m s/rad.
        friction: N or N m.
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
        """Whether the joint is not fixed."""
        return self.kind != "fixed"

    @property
    def rest(self) -> float:
        """The position nearest to 0 within the hard limits."""
        return min(max(0.0, self.lower), self.upper)

    def pose_at(self, position: float) -> Array:
        """Return the pose of the child in the parent's frame at `position`, shape (7,)."""
        return compose(self.origin, self.motion_at(position))

    def motion_at(self, position: float) -> Array:
        """Return the pose of the child relative to `origin` at `position`, shape (7,)."""
        along = position * np.array(self.axis)
        if self.kind == "prismatic":
            return make_pose(along, Rotation.identity())
        return make_pose(np.zeros(3), Rotation.from_rotvec(along))


@dataclass(frozen=True, eq=False)
class Urdf:
    """A tree of links and joints by name, in the file's order; `root` has no parent."""

    name: str
    links: dict[str, Link]
    joints: dict[str, Joint]
    root: str

    @cached_property
    def on(self) -> dict[str, list[Joint]]:
        """The joints whose parent is each link, in the file's order."""
        found: dict[str, list[Joint]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            found[joint.parent].append(joint)
        return found

    @cached_property
    def rigid(self) -> dict[str, frozenset[str]]:
        """The links that are joined rigidly to each link, itself included."""
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
        """Return the joints, fixed ones too, from the root to `link`."""
        path = []
        while link != self.root:
            path.append(self._above[link])
            link = path[-1].parent
        return tuple(reversed(path))

    def below(self, joint: str) -> frozenset[str]:
        """Return the links that the joint of this name carries."""
        return frozenset(_descendants(self.on, self.joints[joint].child))

    def link_poses(
        self, positions: Mapping[str, float], root_pose: Array = IDENTITY
    ) -> dict[str, Array]:
        """Return the poses of all links in the frame that `root_pose` is in, shape (7,) each.

        Positions are rad or m by joint; by default mimic joints follow, and others are at `rest`.
        """
        poses, links = {self.root: root_pose}, [self.root]
        for link in links:
            for joint in self.on[link]:
                leader, scale, offset = self.followed(joint)
                following = scale * positions.get(leader.name, leader.rest) + offset
                motion = joint.motion_at(positions.get(joint.name, following))
                poses[joint.child] = compose(compose(poses[link], joint.origin), motion)
                links.append(joint.child)
        return poses

    def followed(self, joint: Joint) -> tuple[Joint, float, float]:
        """Return the joint at the end of the mimic chain (or `joint`), multiplier and offset."""
        scale, offset = 1.0, 0.0
        while joint.mimic is not None:
            offset += scale * joint.mimic.offset
            scale *= joint.mimic.multiplier
            joint = self.joints[joint.mimic.joint]
        return joint, scale, offset


def _descendants(on: Mapping[str, list[Joint]], link: str) -> list[str]:
    found = [link]
    for one in found:
        found += [joint.child for joint in on[one]]
    return found


def parse_urdf(path: Path) -> Urdf:
    """Return the links and joints of a URDF file."""
    return urdf_of(read_xml(path, "robot"))


def urdf_of(robot: Element) -> Urdf:
    """Return the links and joints of an element <robot>.

    Raises:
        KinfeasError: If they are no tree of supported joints, or a number is missing, not finite or
            out of its range.
    """
    links = {name: _link(name, element) for name, element in _named(robot, "link")}
    joints = {name: _joint(name, element) for name, element in _named(robot, "joint")}
    urdf = Urdf(robot.text("name"), links, joints, _find_root(links, joints.values(), robot))
    if lost := set(links).difference(_descendants(urdf.on, urdf.root)):
        raise robot.error(f"link {min(lost)!r} is on a closed loop of joints")
    _check_mimics(joints, robot)
    return urdf


def _named(robot: Element, tag: str) -> Iterable[tuple[str, Element]]:
    names = set()
    for element in robot.children(tag):
        name = element.text("name")
        if name in names:
            raise robot.error(f"{tag} {name!r}: there are two {tag}s of this name")
        names.add(name)
        yield name, Element(element.xml, f"{robot.where}: {tag} {name!r}")


def _find_root(links: Mapping[str, Link], joints: Iterable[Joint], robot: Element) -> str:
    children = set()
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise robot.error(f"joint {joint.name!r}: there is no link {link!r}")
        if joint.child in children:
            raise robot.error(f"joint {joint.name!r}: link {joint.child!r} has another parent, too")
        children.add(joint.child)
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise robot.error(f"must have one root link, not {', '.join(roots) or 'none'}")
    return roots[0]


def _check_mimics(joints: Mapping[str, Joint], robot: Element) -> None:
    for name, joint in joints.items():
        where, seen, mimic = f"joint {name!r}, <mimic>", {name}, joint.mimic
        while mimic is not None:
            if mimic.joint not in joints or not joints[mimic.joint].moves:
                raise robot.error(f"{where}: there is no moving joint {mimic.joint!r}")
            if mimic.joint in seen:
                raise robot.error(f"{where}: the joint follows itself")
            seen.add(mimic.joint)
            mimic = joints[mimic.joint].mimic


def _link(name: str, element: Element) -> Link:
    # Physics engines read visual shapes from the same file: they are checked here.
    _shapes(element.children("visual"))
    collisions = element.children("collision")
    shapes = tuple(_shapes(collisions))
    return Link(name, _mass(element), shapes, len(shapes) < len(collisions))


def _mass(link: Element) -> float:
    inertial = link.child("inertial")
    if inertial is None:
        return 0.0
    inertial.origin()
    read_moments(inertial.need("inertia"))
    return inertial.need("mass").number("value", limit=_MAX_MASS, minimum=0.0)


def read_moments(inertia: Element) -> Array:
    """Return the matrix of an <inertia>, shape (3, 3), kg m^2."""
    moments = np.zeros((3, 3))
    for name, (row, column) in MOMENTS.items():
        default, minimum = (None, 0.0) if row == column else (0.0, -math.inf)
        value = inertia.number(name, default, _MAX_MOMENT, minimum)
        moments[row, column] = moments[column, row] = value
    return moments


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


def _joint(name: str, element: Element) -> Joint:
    kind = element.text("type")
    if kind not in get_args(JointKind):
        raise element.error(f"type must be one of {', '.join(get_args(JointKind))}, not {kind!r}")
    fixed = kind == "fixed"
    lower, upper = (0.0, 0.0) if fixed else _limits(element, kind)
    soft_lower, soft_upper = _soft_limits(element, kind, lower, upper)
    limit, dynamics, mimic = map(element.child, ("limit", "dynamics", "mimic"))
    velocity, effort, damping, friction = math.inf, math.inf, 0.0, 0.0
    if limit is not None:
        velocity = limit.number("velocity", 0.0, minimum=0.0)
        effort = limit.number("effort", math.inf, minimum=0.0)
    if dynamics is not None:
        damping = dynamics.number("damping", 0.0, minimum=0.0)
        friction = dynamics.number("friction", 0.0, minimum=0.0)
    return Joint(
        name=name,
        kind=cast("JointKind", kind),
        parent=element.need("parent").text("link"),
        child=element.need("child").text("link"),
        origin=element.origin(),
        axis=(1.0, 0.0, 0.0) if fixed else _axis(element),  # exporters write 0 0 0 for fixed joints
        lower=lower,
        upper=upper,
        soft_lower=soft_lower,
        soft_upper=soft_upper,
        velocity=0.0 if fixed else velocity,
        effort=0.0 if fixed else effort,
        damping=damping,
        friction=friction,
        mimic=None if fixed or mimic is None else _mimic(mimic),
    )


def _limits(joint: Element, kind: str) -> tuple[float, float]:
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
    soft = safety.number("soft_lower_limit", lower), safety.number("soft_upper_limit", upper)
    if not lower <= soft[0] <= soft[1] <= upper:
        raise safety.error(
            f"soft limits {soft[0]:g} to {soft[1]:g} are not in {lower:g} to {upper:g}"
        )
    return soft


def _axis(joint: Element) -> tuple[float, float, float]:
    element, default = joint.child("axis"), (1.0, 0.0, 0.0)
    if element is None:
        return default
    axis = np.array(element.vector("xyz", 3, default))
    length = float(np.linalg.norm(axis))
    if length == 0.0:
        raise joint.error("the axis must not be zero")
    x, y, z = (axis / length).tolist()
    return x, y, z


def _mimic(element: Element) -> Mimic:
    numbers = element.number("multiplier", 1.0, FARTHEST), element.number("offset", 0.0, FARTHEST)
    return Mimic(element.text("joint"), *numbers)
