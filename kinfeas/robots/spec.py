"""What the YAML file of a robot may say: the schema, and what can be checked without the URDF."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from kinfeas.config import Interval
from kinfeas.config.quantities import Metres
from kinfeas.core.names import check_name

Drive = Literal["omnidirectional", "differential"]

# What no robot has exceeded; larger numbers are mistakes, or would make anything feasible.
FASTEST_JOINT = 1000.0
Speed = Annotated[float, Interval(low=0.0, high=100.0, open_low=True)]
JointSpeed = Annotated[float, Interval(low=0.0, high=FASTEST_JOINT, open_low=True)]
Acceleration = Annotated[float, Interval(low=0.0, high=1e4, open_low=True)]
Effort = Annotated[float, Interval(low=0.0, high=1e5, open_low=True)]

GOAL_HEIGHTS = ("ggr", "ggr_restricted")
QUATERNION_TOLERANCE = 1e-3
"""Four digits by hand are enough for a unit quaternion; it is normalised when read."""


@dataclass(frozen=True)
class BaseSpec:
    """The block `base`: how the base drives, m/s, rad/s, m/s^2 and rad/s^2."""

    drive: Drive
    max_velocity: Speed
    max_rotation: Speed
    max_acceleration: Acceleration
    max_rotation_acceleration: Acceleration


@dataclass(frozen=True)
class ArmJointSpec:
    """A block within `arm`: what differs from the URDF, m or rad, and per second."""

    soft_limits: tuple[float, float] | None = None
    velocity: JointSpeed | None = None

    def __post_init__(self) -> None:
        """Check that the limits ascend."""
        if self.soft_limits is not None:
            _check_ascending("soft_limits", self.soft_limits)


@dataclass(frozen=True)
class PoseTolerance:
    """How far a pose may be missed and still count as feasible.

    Attributes:
        position: Metres.
        rotation: Radians.
    """

    position: Annotated[float, Interval(low=0.0, high=1.0, open_low=True)]
    rotation: Annotated[float, Interval(low=0.0, high=math.pi, open_low=True)]


@dataclass(frozen=True)
class Gripper:
    """How the gripper closes; other joints of its fingers follow them as the URDF says.

    Attributes:
        fingers: Joints that carry one finger each.
        closed: Their position when closed, rad or m.
        open: Their position when open, rad or m.
        effort: Largest torque or force of each, N m or N.
    """

    fingers: tuple[str, str]
    closed: float
    open: float
    effort: Effort

    def __post_init__(self) -> None:
        """Check that there are two fingers, and that they move."""
        if self.fingers[0] == self.fingers[1]:
            raise ValueError("'fingers' must name two joints")
        if self.closed == self.open:
            raise ValueError("'closed' and 'open' must differ")


@dataclass(frozen=True)
class RobotSpec:
    """The whole file; `urdf` is relative to it, and `robot.Robot` says what the rest means."""

    name: str
    urdf: Path
    ee_frame: str
    tool_tip: tuple[Metres, Metres, Metres]
    gripper_rotation: tuple[float, float, float, float]
    base: BaseSpec
    arm: dict[str, ArmJointSpec]
    home: dict[str, tuple[float, ...]]
    goal_heights: dict[str, tuple[Metres, Metres]]
    fixed_joints: dict[str, float] = field(default_factory=dict)
    pose_tolerance: PoseTolerance | None = None
    ignored_collisions: tuple[tuple[str, str], ...] = ()
    gripper: Gripper | None = None
    counterbalanced: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check what needs no look into the URDF."""
        check_name(self.name)
        if not self.arm:
            raise ValueError("'arm' must name at least one joint")
        if abs(math.hypot(*self.gripper_rotation) - 1.0) > QUATERNION_TOLERANCE:
            raise ValueError("'gripper_rotation' must be a unit quaternion x y z w")
        if "home" not in self.home:
            raise ValueError("'home' must hold a configuration of the name 'home'")
        if set(self.goal_heights) != set(GOAL_HEIGHTS):
            raise ValueError(f"'goal_heights' must hold {' and '.join(GOAL_HEIGHTS)}, and no more")
        for name, heights in self.goal_heights.items():
            _check_ascending(f"goal_heights.{name}", heights)


def _check_ascending(name: str, bounds: tuple[float, float]) -> None:
    if not bounds[0] < bounds[1]:
        raise ValueError(f"{name!r} must ascend, not go from {bounds[0]:g} to {bounds[1]:g}")
