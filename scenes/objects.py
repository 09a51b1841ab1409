"""Objects and handles of a scene, and their blocks in its YAML file."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from annotated_types import Interval

from kinfeas.core.quantities import FARTHEST, Position, Radians
from kinfeas.core.spatial import Array, compose
from kinfeas.robots.urdf import Joint, Shape, Urdf

Angles = tuple[Radians, Radians, Radians]
Side = Annotated[float, Interval(gt=0.0, le=FARTHEST)]


@dataclass(frozen=True)
class ObjectSpec:
    """The YAML block of an object."""

    urdf: Path  # file relative to the scene's folder, or the name of a shipped one
    position: Position = (0.0, 0.0, 0.0)  # world position of its root link, metres
    # roll, pitch and yaw of its root link about the world's axes, radians
    rpy: Angles = (0.0, 0.0, 0.0)
    fixed: bool = True  # whether the root link is fixed to the world
    # joint positions, rad or m; by default the ones nearest to zero
    joints: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class HandleSpec:
    """The YAML block of a handle."""

    object: str  # name of an object
    link: str  # name of one of its links
    position: Position = (0.0, 0.0, 0.0)  # position in the link's frame, metres
    rpy: Angles = (0.0, 0.0, 0.0)  # orientation there, so that x is the approach and z up, radians


@dataclass(frozen=True)
class SceneSpec:
    """The YAML file of a scene."""

    name: str  # name of the scene
    size: tuple[Side, Side]  # size of the floor along x and y, around the origin, metres
    objects: dict[str, ObjectSpec]  # objects by name
    handles: dict[str, HandleSpec] = field(default_factory=dict)  # handles of objects by name


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object with a pose."""

    urdf_path: Path  # file that physics engines load
    urdf: Urdf  # links and joints of that file
    pose: Array  # world pose of its root link, shape (7,)
    fixed: bool  # whether the root link is fixed to the world
    joint_positions: dict[str, float]  # position of each moving joint, rad or m

    @property
    def mass(self) -> float:
        """The mass of all links, kg."""
        return sum(link.mass for link in self.urdf.links.values())

    def link_poses(self) -> dict[str, Array]:
        """Return the world pose of each link, shape (7,)."""
        return self.urdf.link_poses(self.joint_positions, self.pose)

    def shapes(self) -> Iterator[tuple[str, Shape]]:
        """Yield the name of a link and a shape in world coordinates, for each shape."""
        poses = self.link_poses()
        for link in self.urdf.links.values():
            for shape in link.shapes:
                yield link.name, replace(shape, pose=compose(poses[link.name], shape.pose))


@dataclass(frozen=True, eq=False)
class Handle:
    """A grasp frame with x along the approach and z up."""

    object: str  # name of its object
    link: str  # its link
    pose: Array  # pose in the link's frame, shape (7,)
    joint: str | None  # the nearest joint that moves the link, or None


def free_joints(urdf: Urdf) -> dict[str, Joint]:
    """Return the moving joints by name."""
    return {name: joint for name, joint in urdf.joints.items() if joint.moves}


def moving_joint(urdf: Urdf, link: str) -> str | None:
    """Return the nearest moving joint above `link`, or None."""
    moving = [joint.name for joint in urdf.path_to(link) if joint.moves]
    return moving[-1] if moving else None
