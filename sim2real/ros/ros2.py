"""ROS 2: its topics as topics of DDS, so that ROS need not be installed here.

On DDS the topic `/joint_states` of ROS 2 is `rt/joint_states`, and its type is
`sensor_msgs::msg::dds_::JointState_` in the representation XCDR 1
(https://design.ros2.org/articles/topic_and_service_names.html). The message classes below have the
names, fields and defaults of ROS 2.
"""

import logging
import math
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Thread
from types import new_class
from typing import Any

from cyclonedds.core import (
    DDSException,
    GuardCondition,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from kinfeas.core.errors import Fault, KinfeasError
from kinfeas.sim2real.ros.bus import Publisher

_DOMAINS = 232  # the last domain with free ports on Linux
_BLOCKING_MS = 5  # time that a command may wait for its place in the sender's queue
_DELIVERY_MS = 50  # time that closing waits for the delivery of messages
_QUEUE = 100  # messages of topics where every one counts
_UNREAD = ViewState.Any | InstanceState.Any | SampleState.NotRead
_LATCHED = "/tf_static"  # the topic that late subscribers get, too
_NANO = 1_000_000_000
_log = logging.getLogger(__name__)

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

    messages: Any

    def __init__(self) -> None:
        self.messages = sys.modules[__name__]
        self._participant: Any = None
        self._publishers: list[_Ros2Publisher] = []
        self._readers: list[tuple[Any, Any, Callable[[Any], None]]] = []
        self._waits: Any = None
        self._end: Any = None
        self._thread: Thread | None = None

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
        self._waits, self._end = WaitSet(self._participant), GuardCondition(self._participant)
        self._waits.attach(self._end)
        # Not in listeners: an object that Python deletes in a thread of DDS crashes the process.
        self._thread = Thread(target=self._receive, name=name, daemon=True)
        self._thread.start()

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return a sender of the newest message."""
        blocking = Policy.Reliability.Reliable(duration(milliseconds=_BLOCKING_MS))
        qos = _qos(topic, blocking, Policy.History.KeepLast(1))
        writer = DataWriter(self._participant, self._topic(topic, kind), qos=qos)
        self._publishers.append(_Ros2Publisher(topic, writer))
        return self._publishers[-1]

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
        self._readers.append((reader, kind, take))
        self._waits.attach(ReadCondition(reader, _UNREAD))

    def check(self) -> None:
        """Do nothing: DDS has no master, and silence shows as the age of measurements."""

    def check_sending(self) -> None:
        """Do nothing: `publish` raises if the queue of the sender is full."""

    def close(self) -> None:
        """Deliver what was sent and leave the domain; it may be called twice."""
        for publisher in self._publishers:
            publisher.flush()
        if self._thread is not None:
            self._end.set(True)
            self._thread.join()
        self._readers, self._publishers = [], []
        self._thread = self._waits = self._end = self._participant = None

    def _receive(self) -> None:
        while not self._end.read():
            for reader, kind, take in tuple(self._readers):
                try:
                    for message in reader.take(_QUEUE):
                        if isinstance(message, kind):  # not the notice of a sender that has gone
                            take(message)
                except Exception:  # noqa: BLE001 - the next message may be better
                    _log.exception("a message was dropped")
            self._waits.wait(duration(infinite=True))

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


def _message(name: str, methods: dict[str, Any] | None = None, /, **members: Any) -> Any:
    """Return the class of a message; fields are messages, or pairs of a type and a factory."""
    package, short = name.split("/")
    pairs = {
        key: types if isinstance(types, tuple) else (types, types) for key, types in members.items()
    }
    space: dict[str, Any] = {key: field(default_factory=new) for key, (_, new) in pairs.items()}
    space["__annotations__"] = {key: kind for key, (kind, _) in pairs.items()}
    space |= {"__module__": __name__, **(methods or {})}
    typename = {"typename": f"{package}::msg::dds_::{short}_"}
    return dataclass(new_class(short, (IdlStruct,), typename, lambda made: made.update(space)))


def _from_sec(kind: Any, seconds: float) -> Any:
    whole = math.floor(seconds)
    carry, nanosec = divmod(round((seconds - whole) * _NANO), _NANO)
    return kind(whole + carry, nanosec)


def _to_sec(message: Any) -> float:
    seconds: float = message.sec + message.nanosec / _NANO
    return seconds


_STRING, _INT, _UINT, _FLOAT = (str, str), (int32, int), (uint32, int), (float64, float)
_STRINGS, _FLOATS = (sequence[str], list), (sequence[float64], list)
_SINGLE, _SINGLES = (float32, float), (sequence[float32], list)
_COVARIANCE = (array[float64, 36], lambda: [0.0] * 36)
_SECONDS = {"from_sec": classmethod(_from_sec), "to_sec": _to_sec}

Time = _message("builtin_interfaces/Time", _SECONDS, sec=_INT, nanosec=_UINT)
Duration = _message("builtin_interfaces/Duration", _SECONDS, sec=_INT, nanosec=_UINT)
Header = _message("std_msgs/Header", stamp=Time, frame_id=_STRING)
Vector3 = _message("geometry_msgs/Vector3", x=_FLOAT, y=_FLOAT, z=_FLOAT)
Point = _message("geometry_msgs/Point", x=_FLOAT, y=_FLOAT, z=_FLOAT)
Quaternion = _message(
    "geometry_msgs/Quaternion", x=_FLOAT, y=_FLOAT, z=_FLOAT, w=(float64, lambda: 1.0)
)
Pose = _message("geometry_msgs/Pose", position=Point, orientation=Quaternion)
PoseStamped = _message("geometry_msgs/PoseStamped", header=Header, pose=Pose)
Twist = _message("geometry_msgs/Twist", linear=Vector3, angular=Vector3)
TwistStamped = _message("geometry_msgs/TwistStamped", header=Header, twist=Twist)
PoseWithCovariance = _message("geometry_msgs/PoseWithCovariance", pose=Pose, covariance=_COVARIANCE)
TwistWithCovariance = _message(
    "geometry_msgs/TwistWithCovariance", twist=Twist, covariance=_COVARIANCE
)
Odometry = _message(
    "nav_msgs/Odometry",
    header=Header,
    child_frame_id=_STRING,
    pose=PoseWithCovariance,
    twist=TwistWithCovariance,
)
JointState = _message(
    "sensor_msgs/JointState",
    header=Header,
    name=_STRINGS,
    position=_FLOATS,
    velocity=_FLOATS,
    effort=_FLOATS,
)
JointTrajectoryPoint = _message(
    "trajectory_msgs/JointTrajectoryPoint",
    positions=_FLOATS,
    velocities=_FLOATS,
    accelerations=_FLOATS,
    effort=_FLOATS,
    time_from_start=Duration,
)
JointTrajectory = _message(
    "trajectory_msgs/JointTrajectory",
    header=Header,
    joint_names=_STRINGS,
    points=(sequence[JointTrajectoryPoint], list),
)
Transform = _message("geometry_msgs/Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = _message(
    "geometry_msgs/TransformStamped", header=Header, child_frame_id=_STRING, transform=Transform
)
TFMessage = _message("tf2_msgs/TFMessage", transforms=(sequence[TransformStamped], list))
LaserScan = _message(
    "sensor_msgs/LaserScan",
    header=Header,
    angle_min=_SINGLE,
    angle_max=_SINGLE,
    angle_increment=_SINGLE,
    time_increment=_SINGLE,
    scan_time=_SINGLE,
    range_min=_SINGLE,
    range_max=_SINGLE,
    ranges=_SINGLES,
    intensities=_SINGLES,
)
MapMetaData = _message(
    "nav_msgs/MapMetaData",
    map_load_time=Time,
    resolution=_SINGLE,
    width=_UINT,
    height=_UINT,
    origin=Pose,
)
OccupancyGrid = _message(
    "nav_msgs/OccupancyGrid", header=Header, info=MapMetaData, data=(sequence[int8], list)
)
