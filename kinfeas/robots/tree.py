"""What a URDF describes: a tree of links, held together by joints."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, compose, make_pose

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
