"""What stands in a scene: furniture and things, each a URDF of primitives, and their handles."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from kinfeas.config import Interval
from kinfeas.config.quantities import FARTHEST, Position, Radians
from kinfeas.core.spatial import Array, compose
from kinfeas.robots.urdf import Joint, Shape, Urdf


@dataclass(frozen=True, eq=False)
class SceneObject:
    """Something with a place.

    Attributes:
        urdf_path: File that physics engines load.
        urdf: What that file says: links with their masses and shapes, joints with their limits,
            friction and damping.
        pose: World pose of its root link, shape (7,).
        fixed: Whether the root link stays where it is.
        joint_positions: Position of each joint that moves, rad or m.
    """

    urdf_path: Path
    urdf: Urdf
    pose: Array
    fixed: bool
    joint_positions: dict[str, float]

    @property
    def mass(self) -> float:
        """Return what all its links weigh together, kg."""
        return sum(link.mass for link in self.urdf.links.values())

    def link_poses(self) -> dict[str, Array]:
        """Return the world pose of each link, shape (7,)."""
        poses = {self.urdf.root: self.pose}
        while len(poses) < len(self.urdf.links):
            for joint in self.urdf.joints.values():
                if joint.parent in poses and joint.child not in poses:
                    origin = compose(poses[joint.parent], joint.origin)
                    position = self.joint_positions.get(joint.name, 0.0)
                    poses[joint.child] = compose(origin, joint.motion_at(position))
        return poses

    def shapes(self) -> Iterator[tuple[str, Shape]]:
        """Yield each shape with the name of its link; its pose is that in the world."""
        poses = self.link_poses()
        for link in self.urdf.links.values():
            for shape in link.shapes:
                yield link.name, replace(shape, pose=compose(poses[link.name], shape.pose))


@dataclass(frozen=True, eq=False)
class Handle:
    """Where a gripper takes hold: a frame with x along the approach and z up.

    Attributes:
        object: Name of the object that it belongs to.
        link: Its link.
        pose: The frame in the frame of that link, shape (7,).
        joint: The nearest joint that moves the link, None if none does.
    """

    object: str
    link: str
    pose: Array
    joint: str | None


def free_joints(urdf: Urdf) -> dict[str, Joint]:
    """Return the joints that move, by name."""
    return {name: joint for name, joint in urdf.joints.items() if joint.moves}


def rest_positions(urdf: Urdf, given: Mapping[str, float]) -> dict[str, float]:
    """Return `given` with the position nearest to zero for each other joint that moves."""
    return {
        name: given.get(name, float(np.clip(0.0, joint.lower, joint.upper)))
        for name, joint in free_joints(urdf).items()
    }


def moving_joint(urdf: Urdf, link: str) -> str | None:
    """Return the nearest joint above `link` that moves, or None."""
    moving = [joint.name for joint in urdf.path_to(link) if joint.moves]
    return moving[-1] if moving else None


Angles = tuple[Radians, Radians, Radians]
Side = Annotated[float, Interval(low=0.0, high=FARTHEST, open_low=True)]


@dataclass(frozen=True)
class ObjectSpec:
    """An object as its YAML block says it.

    Attributes:
        urdf: File, from the scene's folder on, or the name of a shipped one.
        position: Of its root link in the world, metres.
        rpy: Roll, pitch and yaw of it about the world's axes, one after the other, radians.
        fixed: Whether the root link stays where it is.
        joints: Positions of joints, rad or m; the others rest as near to zero as they can.
    """

    urdf: Path
    position: Position = (0.0, 0.0, 0.0)
    rpy: Angles = (0.0, 0.0, 0.0)
    fixed: bool = True
    joints: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class HandleSpec:
    """A handle as its YAML block says it.

    Attributes:
        object: Name of an object.
        link: Name of one of its links.
        position: Of the handle in the link's frame, metres.
        rpy: Its turn there, so that x is the approach and z up, radians.
    """

    object: str
    link: str
    position: Position = (0.0, 0.0, 0.0)
    rpy: Angles = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SceneSpec:
    """A scene as its YAML file says it.

    Attributes:
        name: Short name.
        size: Of the floor along x and y, metres; the origin is its middle.
        objects: What stands there, by name.
        handles: Where grippers take hold, by name.
    """

    name: str
    size: tuple[Side, Side]
    objects: dict[str, ObjectSpec]
    handles: dict[str, HandleSpec] = field(default_factory=dict)
