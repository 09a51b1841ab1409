"""The YAML file of a scene, as dataclasses."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from kinfeas.config import Interval
from kinfeas.config.quantities import FARTHEST, Position, Radians

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
