"""The messages of ROS 2 that a robot is driven with, as DDS carries them.

Names, fields and their order are those of ROS 2's packages; a message that is made without
arguments holds what ROS 2 puts into a new one.
"""

# mypy: disable-error-code="call-arg"
# (the base class, which names a type on DDS, is Any to mypy)

import math
from dataclasses import dataclass, field

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint32

_NANO = 1_000_000_000


def _split(seconds: float) -> tuple[int, int]:
    """Return whole seconds and the nanoseconds that are left, at least 0."""
    whole = math.floor(seconds)
    carry, nanosec = divmod(round((seconds - whole) * _NANO), _NANO)
    return whole + carry, nanosec


def _joined(sec: int, nanosec: int) -> float:
    return sec + nanosec / _NANO


# A base class that both had would be a part of their types on DDS, which ROS 2's do not have.
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """A moment since 1970, or since whatever a clock counts from."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @classmethod
    def from_sec(cls, seconds: float) -> "Time":
        """Return it from seconds."""
        return cls(*_split(seconds))

    def to_sec(self) -> float:
        """Return it in seconds."""
        return _joined(self.sec, self.nanosec)


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    """A span of time."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @classmethod
    def from_sec(cls, seconds: float) -> "Duration":
        """Return it from seconds."""
        return cls(*_split(seconds))

    def to_sec(self) -> float:
        """Return it in seconds."""
        return _joined(self.sec, self.nanosec)


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """When something was measured, and in which frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """A direction, m or rad, or per second."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """A position, m."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    """An orientation."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    """A position and an orientation."""

    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    """A velocity, m/s and rad/s."""

    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    """A velocity and when it was commanded."""

    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


def _no_covariance() -> list[float]:
    return [0.0] * 36


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    """A pose and how sure it is."""

    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=_no_covariance)


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    """A velocity and how sure it is."""

    twist: Twist = field(default_factory=Twist)
    covariance: array[float64, 36] = field(default_factory=_no_covariance)


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    """Where the base is in the header's frame, and how it moves in its own."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """Where joints are."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectoryPoint_"):
    """Where joints shall be, and when."""

    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectory_"):
    """Where joints shall pass through."""

    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    """Where one frame is in another."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    """Where one frame is in the header's, and when."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    """Some transforms."""

    transforms: sequence[TransformStamped] = field(default_factory=list)
