"""The YAML file of a robot as dataclasses."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas.core.backend import Grip
from kinfeas.core.errors import check_name
from kinfeas.core.quantities import Metres
from kinfeas.core.response import ResponseModel

Drive = Literal["omnidirectional", "differential"]

MAX_JOINT_VELOCITY = 1000.0  # rad/s or m/s; larger numbers in a URDF stand for no limit
GUESSED_VELOCITY = {"revolute": 1.0, "continuous": 1.0, "prismatic": 0.1}  # if none is given

Velocity = Annotated[float, Interval(gt=0.0, le=100.0)]
JointVelocity = Annotated[float, Interval(gt=0.0, le=MAX_JOINT_VELOCITY)]
Acceleration = Annotated[float, Interval(gt=0.0, le=1e4)]
GravityLoad = Annotated[float, Interval(gt=0.0, le=1.0)]
Effort = Annotated[float, Interval(gt=0.0, le=1e5)]


@dataclass(frozen=True)
class BaseSpec:
    """The block `base`."""

    drive: Drive  # whether the base can drive sideways
    max_velocity: Velocity  # limit of the speed, m/s
    max_rotation: Velocity  # limit of the angular speed, rad/s
    max_acceleration: Acceleration  # limit of the acceleration, m/s^2
    max_rotation_acceleration: Acceleration  # limit of the angular acceleration, rad/s^2


@dataclass(frozen=True)
class ArmJointSpec:
    """A block within `arm`."""

    # limits within those of the URDF, rad or m; the URDF's if null
    soft_limits: tuple[float, float] | None = None
    velocity: JointVelocity | None = None  # velocity limit, rad/s or m/s; the URDF's if null


@dataclass(frozen=True)
class PoseTolerance:
    """Pose error that still counts as feasible."""

    position: Annotated[float, Interval(gt=0.0, le=1.0)]  # position error, metres
    rotation: Annotated[float, Interval(gt=0.0, le=math.pi)]  # rotation error, radians


@dataclass(frozen=True)
class GripperSpec:
    """A two-finger gripper; mimic joints of the fingers move along."""

    fingers: tuple[str, str]  # joint of each finger
    # their position when closed, rad or m; one number, or one for each
    closed: float | tuple[float, float]
    open: float | tuple[float, float]  # their position when open, likewise
    effort: Effort  # effort limit of each, N m or N
    # velocity limit of each, rad/s or m/s; the URDF's if null, 1 rad/s or 0.1 m/s if it has none
    velocity: JointVelocity | None = None

    def __post_init__(self) -> None:
        if self.fingers[0] == self.fingers[1]:
            raise ValueError("'fingers' must name two joints")
        if not all(self._strokes):
            raise ValueError("'closed' and 'open' must differ, for each finger")

    def positions(self, grip: Grip) -> dict[str, float]:
        """Return the position of each finger, rad or m, when closed or open."""
        position = self.closed if grip == "close" else self.open
        positions = position if isinstance(position, tuple) else (position, position)
        return dict(zip(self.fingers, positions, strict=True))

    @property
    def ratio(self) -> float:
        """Displacement of the second finger divided by the first one's; 1 if they move alike."""
        first, second = self._strokes
        return second / first

    @property
    def _strokes(self) -> list[float]:
        closed, opened = self.positions("close"), self.positions("open")
        return [opened[finger] - closed[finger] for finger in self.fingers]


@dataclass(frozen=True)
class Reach:
    """Heights of the EE above the floor at which the robot reaches most poses."""

    low: Metres  # lowest height, metres
    high: Metres  # highest height, metres

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError("'low' must be less than 'high'")

    @property
    def comfortable(self) -> tuple[float, float]:
        """Lowest and highest EE height of easy goals, metres, 0.2 m within reach, at most 1.1."""
        margin = min(0.2, (self.high - self.low) / 4.0)
        return self.low + margin, max(min(self.high - margin, 1.1), (self.low + self.high) / 2.0)


@dataclass(frozen=True)
class RobotSpec:
    """The file `robot.yaml`."""

    name: str  # short name, stored in trained policies
    ee_frame: str  # EE link: the frame of motions and IK
    tool_tip: tuple[Metres, Metres, Metres]  # position of the tool tip in the EE frame, metres
    # quaternion x y z w from the common gripper convention (x is the approach, y the finger axis)
    # to the EE frame
    gripper_rotation: tuple[float, float, float, float]
    base: BaseSpec  # drive and limits of the base
    arm: dict[str, ArmJointSpec]  # joints of IK from the root to the EE, including a lift
    home: dict[str, tuple[float, ...]]  # arm configurations by name, rad or m; one is named `home`
    reach: Reach  # heights of EE goals; tasks derive theirs from it
    urdf: Path = Path("robot.urdf")  # path of the URDF, relative to this file
    # positions of other joints, rad or m, by default nearest to 0; required between root and EE
    fixed_joints: dict[str, float] = field(default_factory=dict)
    # error allowed during motions, for arms with fewer than six joints
    pose_tolerance: PoseTolerance | None = None
    # pairs of links that may touch; adjacent links always may
    ignored_collisions: tuple[tuple[str, str], ...] = ()
    gripper: GripperSpec | None = None  # two fingers; none if null
    # arm joints with spring-compensated load: with physics, and for `max_gravity_load`
    counterbalanced: tuple[str, ...] = ()
    # largest gravity torque of a posture as a fraction of the effort limits in the URDF; IK,
    # `ceiling` and the planners leave other postures out. Not checked if null, nor for joints
    # without an effort limit
    max_gravity_load: GravityLoad | None = None
    # how late the robot carries out commands and is measured, as `kinfeas identify` finds it
    response: ResponseModel = field(default_factory=ResponseModel)

    def __post_init__(self) -> None:
        check_name(self.name)
        if not self.arm:
            raise ValueError("'arm' must name at least one joint")
        # Four digits are precise enough in a file; the quaternion is normalised on loading.
        if abs(math.hypot(*self.gripper_rotation) - 1.0) > 1e-3:
            raise ValueError("'gripper_rotation' must be a unit quaternion x y z w")
        if "home" not in self.home:
            raise ValueError("'home' must hold a configuration of the name 'home'")
