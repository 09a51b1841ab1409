"""The YAML file of a robot as dataclasses; `robot.Robot` describes the meaning of its keys."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas.config.quantities import Metres
from kinfeas.core.errors import check_name

Drive = Literal["omnidirectional", "differential"]

MAX_JOINT_VELOCITY = 1000.0
"""rad/s or m/s; larger numbers in a URDF stand for no limit."""

Velocity = Annotated[float, Interval(gt=0.0, le=100.0)]
JointVelocity = Annotated[float, Interval(gt=0.0, le=MAX_JOINT_VELOCITY)]
Acceleration = Annotated[float, Interval(gt=0.0, le=1e4)]
GravityLoad = Annotated[float, Interval(gt=0.0, le=1.0)]
Effort = Annotated[float, Interval(gt=0.0, le=1e5)]

GOAL_HEIGHTS = ("ggr", "ggr_restricted")


@dataclass(frozen=True)
class BaseSpec:
    """The block `base`: drive type, and limits in m/s, rad/s, m/s^2 and rad/s^2."""

    drive: Drive
    max_velocity: Velocity
    max_rotation: Velocity
    max_acceleration: Acceleration
    max_rotation_acceleration: Acceleration


@dataclass(frozen=True)
class ArmJointSpec:
    """A block within `arm`: values in place of the URDF's, m or rad, and per second."""

    soft_limits: tuple[float, float] | None = None
    velocity: JointVelocity | None = None


@dataclass(frozen=True)
class PoseTolerance:
    """Pose error that still counts as feasible, metres and radians."""

    position: Annotated[float, Interval(gt=0.0, le=1.0)]
    rotation: Annotated[float, Interval(gt=0.0, le=math.pi)]


@dataclass(frozen=True)
class Gripper:
    """A two-finger gripper; mimic joints of the fingers move along.

    Attributes:
        fingers: Joint of each finger.
        closed: Their position when closed, rad or m.
        open: Their position when open, rad or m.
        effort: Effort limit of each, N m or N.
    """

    fingers: tuple[str, str]
    closed: float
    open: float
    effort: Effort

    def __post_init__(self) -> None:
        """Check that the fingers differ and move."""
        if self.fingers[0] == self.fingers[1]:
            raise ValueError("'fingers' must name two joints")
        if self.closed == self.open:
            raise ValueError("'closed' and 'open' must differ")


@dataclass(frozen=True)
class RobotSpec:
    """The whole file; `urdf` is relative to it."""

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
    max_gravity_load: GravityLoad | None = None

    def __post_init__(self) -> None:
        """Check everything that does not need the URDF."""
        check_name(self.name)
        if not self.arm:
            raise ValueError("'arm' must name at least one joint")
        # Four digits are precise enough in a file; the quaternion is normalised on loading.
        if abs(math.hypot(*self.gripper_rotation) - 1.0) > 1e-3:
            raise ValueError("'gripper_rotation' must be a unit quaternion x y z w")
        if "home" not in self.home:
            raise ValueError("'home' must hold a configuration of the name 'home'")
        if set(self.goal_heights) != set(GOAL_HEIGHTS):
            raise ValueError(f"'goal_heights' must hold {' and '.join(GOAL_HEIGHTS)}, and no more")
        for name, (low, high) in self.goal_heights.items():
            if not low < high:
                raise ValueError(f"'goal_heights.{name}' must ascend")
