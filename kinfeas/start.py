"""Where episodes begin."""

from dataclasses import dataclass

from kinfeas.spatial import Array


@dataclass(frozen=True)
class Start:
    """Where n episodes begin and where their motions lead.

    Attributes:
        base_pose: World pose of the base, shape (n, 7).
        joint_positions: Arm joints, shape (n, j), radians or metres.
        target_poses: What the motion of each leg heads for, in the world, shape (n, legs, 7).
    """

    base_pose: Array
    joint_positions: Array
    target_poses: Array
