"""The model of a URDF file: a tree of links and joints."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import IDENTITY, Array, compose, make_pose

ShapeKind = Literal["box", "cylinder", "sphere"]
JointKind = Literal["fixed", "revolute", "continuous", "prismatic"]


@dataclass(frozen=True, eq=False)
class Shape:
    """A primitive of a link's collision geometry."""

    kind: ShapeKind  # kind of primitive
    size: tuple[float, ...]  # box: x, y and z; cylinder: radius, length; sphere: radius; metres
    pose: Array  # pose of its centre in the link's frame, shape (7,)

    @cached_property
    def half(self) -> Array:
        """Half extents along its own axes, shape (3,), metres."""
        if self.kind == "box":
            return np.array(self.size) / 2.0
        radius, length = self.size if self.kind == "cylinder" else (*self.size, 2.0 * self.size[0])
        return np.array([radius, radius, length / 2.0])

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

    `mesh_collisions` is whether it also has collision meshes, which are not read; `centre` is the
    centre of mass in the link's frame, shape (3,), metres.
    """

    name: str
    mass: float
    shapes: tuple[Shape, ...]
    mesh_collisions: bool
    centre: Array


@dataclass(frozen=True)
class Mimic:
    """A coupling to another joint: position = multiplier * position of `joint` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint; positions are radians, or metres if it is prismatic."""

    name: str
    kind: JointKind
    parent: str
    child: str
    origin: Array  # pose of the child in the parent's frame at position 0, shape (7,)
    axis: tuple[float, float, float]  # unit vector in the joint's frame
    lower: float  # hard lower limit; -inf for a continuous joint, 0 for a fixed one
    upper: float  # hard upper limit; inf for a continuous joint, 0 for a fixed one
    soft_lower: float  # lower limit of the safety controller, by default the hard one
    soft_upper: float  # upper limit of the safety controller, by default the hard one
    velocity: float  # velocity limit, per second; inf for a continuous joint without a limit
    effort: float  # effort limit, N or N m; inf where none is given
    damping: float  # N s/m or N m s/rad
    friction: float  # N or N m
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
        """Joints by the name of their parent link, in the file's order."""
        joints: dict[str, list[Joint]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            joints[joint.parent].append(joint)
        return joints

    @cached_property
    def rigid(self) -> dict[str, frozenset[str]]:
        """For each link, the links that are joined to it rigidly, itself included."""
        groups: dict[str, frozenset[str]] = {}
        for base in (self.root, *(joint.child for joint in self.joints.values() if joint.moves)):
            group = [base]
            for link in group:
                group += [joint.child for joint in self.on[link] if not joint.moves]
            groups |= dict.fromkeys(group, frozenset(group))
        return groups

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
        """Return the links that the joint of this name moves."""
        return frozenset(descendants(self.on, self.joints[joint].child))

    def link_poses(
        self, positions: Mapping[str, float], root_pose: Array = IDENTITY
    ) -> dict[str, Array]:
        """Return the poses of all links by name, shape (7,) each, in the frame of `root_pose`.

        Positions are rad or m by the name of the joint; mimic joints without a position follow
        their leader, and other joints without one are at `rest`.
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


def descendants(on: Mapping[str, list[Joint]], link: str) -> list[str]:
    """Return a link and all links below it; `on` has the joints by their parent link."""
    links = [link]
    for name in links:
        links += [joint.child for joint in on[name]]
    return links
