"""ROS 2: its topics as topics of DDS, so that ROS need not be installed here.

On DDS the topic `/joint_states` of ROS 2 is `rt/joint_states`, and its type is
`sensor_msgs::msg::dds_::JointState_` in the representation XCDR 1
(https://design.ros2.org/articles/topic_and_service_names.html). The message classes below have the
names, fields and defaults of ROS 2.
"""

# mypy: disable-error-code="call-arg"
# (cyclonedds has no types: the base class of messages is Any)

import math
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from cyclonedds.core import DDSException, Listener, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.sim2real.ros.bus import Messages, Publisher

_DOMAINS = 232  # the last domain with free ports on Linux
_BLOCKING_MS = 5  # time that a command may wait for its place in the sender's queue
_DELIVERY_MS = 50  # time that closing waits for the delivery of messages
_QUEUE = 100  # messages of topics where every one counts
_LATCHED = "/tf_static"  # the topic that late subscribers get, too
_NANO = 1_000_000_000

_LOCAL = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    "<Peers><Peer Address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)


class Ros2Bus:
    """Topics of ROS 2 over Eclipse Cyclone DDS.

    `ROS_DOMAIN_ID` and `CYCLONEDDS_URI` apply as to any node. `ROS_LOCALHOST_ONLY=1` or
    `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` keeps messages on this machine.

    Attributes:
        messages: Message classes.
    """

    messages: Messages

    def __init__(self) -> None:
        """Prepare a bus; `open` connects."""
        self.messages = ros2_message_classes()
        self._participant: Any = None
        self._publishers: list[_Ros2Publisher] = []
        self._readers: list[Any] = []

    def open(self, name: str) -> None:
        """Join the domain; raise KinfeasError if there is none of this number."""
        domain = _domain()
        if _local_only():
            os.environ.setdefault("CYCLONEDDS_URI", _LOCAL)
        try:
            self._participant = DomainParticipant(domain, qos=Qos(Policy.EntityName(name)))
        except DDSException as error:
            uri = os.environ.get("CYCLONEDDS_URI")
            settings = f" with CYCLONEDDS_URI={uri}" if uri else ""
            raise KinfeasError(f"DDS cannot join domain {domain}{settings}: {error}") from error

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return a sender of the newest message."""
        blocking = Policy.Reliability.Reliable(duration(milliseconds=_BLOCKING_MS))
        qos = _qos(topic, blocking, Policy.History.KeepLast(1))
        made = _Ros2Publisher(
            topic, DataWriter(self._participant, self._topic(topic, kind), qos=qos)
        )
        self._publishers.append(made)
        return made

    def subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], *, every: bool = False
    ) -> None:
        """Pass messages to `take`, from a thread: `every` one, or the newest."""
        # Best effort matches senders of both kinds.
        policies = [Policy.Reliability.BestEffort, Policy.History.KeepLast(1)]
        if every:
            reliable = Policy.Reliability.Reliable(duration(milliseconds=_BLOCKING_MS))
            policies = [reliable, Policy.History.KeepLast(_QUEUE)]
        reader = DataReader(self._participant, self._topic(topic, kind), qos=_qos(topic, *policies))
        self._readers.append(reader)

        def pass_on(_: object) -> None:
            for message in reader.take(_QUEUE):
                if isinstance(message, kind):  # not the notice of a sender that has gone
                    take(message)

        reader.set_listener(Listener(on_data_available=pass_on))
        pass_on(reader)  # messages before the listener

    def check(self) -> None:
        """Do nothing: DDS has no master, and silence shows as the age of measurements."""

    def check_sending(self) -> None:
        """Do nothing: `publish` raises if the queue of the sender is full."""

    def close(self) -> None:
        """Deliver what was sent and leave the domain; it may be called twice."""
        for publisher in self._publishers:
            publisher.flush()
        for reader in self._readers:
            reader.set_listener(None)
        self._readers, self._publishers, self._participant = [], [], None

    def _topic(self, name: str, kind: Any) -> Any:
        return Topic(self._participant, f"rt/{name.lstrip('/')}", kind)


class _Ros2Publisher:
    def __init__(self, topic: str, writer: Any) -> None:
        self._topic, self._writer = topic, writer

    def publish(self, message: Any) -> None:
        try:
            self._writer.write(message)
        except DDSException as error:
            raise Fault(f"nothing can be sent to {self._topic}: {error}") from error

    def listeners(self) -> int:
        return len(self._writer.get_matched_subscriptions())

    def flush(self) -> None:
        with suppress(AttributeError):  # cyclonedds 0.10 misspells the constant of its time-out
            self._writer.wait_for_acks(duration(milliseconds=_DELIVERY_MS))


def _qos(topic: str, *policies: Any) -> Any:
    """Return the quality of service of a topic, as ROS 2 has it."""
    latched = topic == _LATCHED
    durability = Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile
    return Qos(Policy.DataRepresentation(use_cdrv0_representation=True), durability, *policies)


def _domain() -> int:
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isdecimal() and int(text) <= _DOMAINS):
        raise KinfeasError(f"ROS_DOMAIN_ID must be a number from 0 to {_DOMAINS}, not {text!r}")
    return int(text)


def _local_only() -> bool:
    only = os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    return only or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"


def ros2_message_classes() -> Messages:
    """Return the message classes of ROS 2."""
    return Messages(
        Twist=Twist,
        TwistStamped=TwistStamped,
        Odometry=Odometry,
        JointState=JointState,
        JointTrajectory=JointTrajectory,
        JointTrajectoryPoint=JointTrajectoryPoint,
        TFMessage=TFMessage,
        TransformStamped=TransformStamped,
        Time=Time,
        Duration=Duration,
    )


def _split(seconds: float) -> tuple[int, int]:
    """Return whole seconds and the remaining nanoseconds, at least 0."""
    whole = math.floor(seconds)
    carry, nanosec = divmod(round((seconds - whole) * _NANO), _NANO)
    return whole + carry, nanosec


# A common base class of both would change their types on DDS.
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """A time since 1970, or since the start of a clock."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @classmethod
    def from_sec(cls, seconds: float) -> "Time":
        """Return the message of a time in seconds."""
        return cls(*_split(seconds))

    def to_sec(self) -> float:
        """Return the time in seconds."""
        return self.sec + self.nanosec / _NANO


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    """A duration."""

    sec: int32 = 0
    nanosec: uint32 = 0

    @classmethod
    def from_sec(cls, seconds: float) -> "Duration":
        """Return the message of a duration in seconds."""
        return cls(*_split(seconds))

    def to_sec(self) -> float:
        """Return the duration in seconds."""
        return self.sec + self.nanosec / _NANO


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """Time and frame of a measurement."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """A vector, m or rad, or per second."""

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
    """A velocity and the time of its command."""

    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


def _no_covariance() -> list[float]:
    return [0.0] * 36


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    """A pose and its covariance."""

    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=_no_covariance)


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    """A velocity and its covariance."""

    twist: Twist = field(default_factory=Twist)
    covariance: array[float64, 36] = field(default_factory=_no_covariance)


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    """Base pose in the header's frame, and velocity in the frame of the base."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """Joint positions by name."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectoryPoint_"):
    """A point of a joint trajectory."""

    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectory_"):
    """A joint trajectory."""

    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    """A pose of one frame in another."""

    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    """A pose of a frame in the header's frame, and its time."""

    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    """Transforms of TF."""

    transforms: sequence[TransformStamped] = field(default_factory=list)
