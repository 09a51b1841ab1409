"""What a task does to the objects of a scene, in worlds that have them."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.config.quantities import Position, Radians
from kinfeas.core.spatial import Array, compose, make_pose


@dataclass(frozen=True)
class Move:
    """Where an object stands in an episode.

    Attributes:
        place: Name of a place of the task, to which a sub-goal leads.
        offset: From there to the object, along the place's own axes, metres.
        turn: Of the object about the place's z axis, radians.
    """

    place: str
    offset: Position = (0.0, 0.0, 0.0)
    turn: Radians = 0.0

    def carry(self, place: Array) -> Array:
        """Return the world pose of the object, shape (7,), where the place is at a pose (7,)."""
        turn = Rotation.from_rotvec([0.0, 0.0, self.turn])
        return compose(place, make_pose(np.array(self.offset), turn))


@dataclass(frozen=True)
class GraspedObject:
    """What the gripper takes hold of.

    Attributes:
        object: Name of an object of the scene.
        link: Its link.
        revolute: Whether the link can turn in the hand, as a bar can.
    """

    object: str
    link: str
    revolute: bool = False


@dataclass(frozen=True)
class SuccessCondition:
    """When a task is done: an object stands on another one, or one of its joints is open.

    Attributes:
        object: Name of an object of the scene.
        parent: Name of the object that it stands on.
        joint: Its joint.
        threshold: Position that the joint has passed, rad or m; downwards if below 0.
    """

    object: str
    parent: str | None = None
    joint: str | None = None
    threshold: float = 0.0

    def __post_init__(self) -> None:
        """Check that it says one of the two."""
        if (self.parent is None) == (self.joint is None):
            raise ValueError("one of 'parent' and 'joint' must be given, and not both")


@dataclass(frozen=True)
class TaskScene:
    """What a task does to the objects of a scene.

    Attributes:
        name: The scene, by its name or the path of its YAML.
        success: When the task has succeeded.
        grasped_object: What the gripper takes hold of; nothing by default.
        moves: Where objects stand that an episode puts elsewhere, by their names.
    """

    name: str
    success: SuccessCondition
    grasped_object: GraspedObject | None = None
    moves: dict[str, Move] = field(default_factory=dict)
