"""The YAML file of a robot as dataclasses."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas.config.quantities import Metres
from kinfeas.core.backend import Grip
from kinfeas.core.errors import check_name
from kinfeas.core.response import ResponseModel

Drive = Literal["omnidirectional", "differential"]

MAX_JOINT_VELOCITY = 1000.0  # rad/s or m/s; larger numbers in a URDF stand for no limit

Velocity = Annotated[float, Interval(gt=0.0, le=100.0)]
JointVelocity = Annotated[float, Interval(gt=0.0, le=MAX_JOINT_VELOCITY)]
Acceleration = Annotated[float, Interval(gt=0.0, le=1e4)]
GravityLoad = Annotated[float, Interval(gt=0.0, le=1.0)]
Effort = Annotated[float, Interval(gt=0.0, le=1e5)]


@dataclass(frozen=True)
class BaseSpec:
    """The block `base`.

    Attributes:
        drive: Whether the base can drive sideways.
        max_velocity: Limit of the speed, m/s.
        max_rotation: Limit of the angular speed, rad/s.
        max_acceleration: Limit of the acceleration, m/s^2.
        max_rotation_acceleration: Limit of the angular acceleration, rad/s^2.
    """

    drive: Drive
    max_velocity: Velocity
    max_rotation: Velocity
    max_acceleration: Acceleration
    max_rotation_acceleration: Acceleration


@dataclass(frozen=True)
class ArmJointSpec:
    """A block within `arm`.

    Attributes:
        soft_limits: Limits within those of the URDF, rad or m; the URDF's if null.
        velocity: Velocity limit, rad/s or m/s; the URDF's if null.
    """

    soft_limits: tuple[float, float] | None = None
    velocity: JointVelocity | None = None


@dataclass(frozen=True)
class PoseTolerance:
    """Pose error that still counts as feasible.

    Attributes:
        position: Position error, metres.
        rotation: Rotation error, radians.
    """

    position: Annotated[float, Interval(gt=0.0, le=1.0)]
    rotation: Annotated[float, Interval(gt=0.0, le=math.pi)]


@dataclass(frozen=True)
class Gripper:
    """A two-finger gripper; mimic joints of the fingers move along.

    Attributes:
        fingers: Joint of each finger.
        closed: Their position when closed, rad or m; one number, or one for each.
        open: Their position when open, likewise.
        effort: Effort limit of each, N m or N.
    """

    fingers: tuple[str, str]
    closed: float | tuple[float, float]
    open: float | tuple[float, float]
    effort: Effort

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
        """Displacement of the second finger by that of the first; 1 if they move alike."""
        first, second = self._strokes
        return second / first

    @property
    def _strokes(self) -> list[float]:
        closed, opened = self.positions("close"), self.positions("open")
        return [opened[finger] - closed[finger] for finger in self.fingers]


@dataclass(frozen=True)
class Reach:
    """Heights of the EE above the floor at which the robot reaches most poses.

    Attributes:
        low: Lowest height, metres.
        high: Highest height, metres.
    """

    low: Metres
    high: Metres

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError("'low' must be less than 'high'")

    @property
    def comfortable(self) -> tuple[float, float]:
        """Lowest and highest EE of easy goals, metres: 0.2 m within the reach, at most 1.1 m."""
        margin = min(0.2, (self.high - self.low) / 4.0)
        return self.low + margin, max(min(self.high - margin, 1.1), (self.low + self.high) / 2.0)


@dataclass(frozen=True)
class RobotSpec:
    """The file `robot.yaml`.

    Attributes:
        name: Short name, stored in trained policies.
        ee_frame: EE link: the frame of motions and IK.
        tool_tip: Position of the tool tip in the EE frame, metres.
        gripper_rotation: Quaternion x y z w from the common gripper convention (x is the approach,
            y the finger axis) to the EE frame.
        base: Drive and limits of the base.
        arm: Joints of IK from the root to the EE, including a lift.
        home: Arm configurations by name, rad or m; one is named `home`.
        reach: Heights of EE goals; tasks derive theirs from it.
        urdf: Path of the URDF, relative to this file.
        fixed_joints: Positions of other joints, rad or m, by default as close to 0 as possible;
            required between root and EE.
        pose_tolerance: Error allowed during motions, for arms with fewer than six joints.
        ignored_collisions: Pairs of links that may touch; adjacent links always may.
        gripper: Two fingers; none if null.
        counterbalanced: Arm joints with spring-compensated load: with physics, and for
            `max_gravity_load`.
        max_gravity_load: Largest gravity torque of a posture as a fraction of the effort limits in
            the URDF; IK, `ceiling` and the planners leave other postures out. Not checked if null,
            nor for joints without an effort limit.
        response: How late the robot carries out commands and is measured, as `kinfeas identify`
            finds it.
    """

    name: str
    ee_frame: str
    tool_tip: tuple[Metres, Metres, Metres]
    gripper_rotation: tuple[float, float, float, float]
    base: BaseSpec
    arm: dict[str, ArmJointSpec]
    home: dict[str, tuple[float, ...]]
    reach: Reach
    urdf: Path = Path("robot.urdf")
    fixed_joints: dict[str, float] = field(default_factory=dict)
    pose_tolerance: PoseTolerance | None = None
    ignored_collisions: tuple[tuple[str, str], ...] = ()
    gripper: Gripper | None = None
    counterbalanced: tuple[str, ...] = ()
    max_gravity_load: GravityLoad | None = None
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
