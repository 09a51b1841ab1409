"""ROS 2: its topics and services as topics of DDS, so that ROS need not be installed here.

On DDS the topic `/joint_states` of ROS 2 is `rt/joint_states`, and its type is
`sensor_msgs::msg::dds_::JointState_` in the representation XCDR 1. The service `/compute_ik` is the
topics `rq/compute_ikRequest` and `rr/compute_ikReply`
(https://design.ros2.org/articles/topic_and_service_names.html). `MESSAGES` have the names, fields
and defaults of ROS 2.
"""

import logging
import math
import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from types import SimpleNamespace, new_class
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
from cyclonedds.idl.types import (
    array,
    float32,
    float64,
    int8,
    int32,
    int64,
    sequence,
    uint8,
    uint32,
    uint64,
)
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
_ENDING = 2.0  # s for which closing waits for the answer to a request
_MATCHING = 0.1  # s that a reply waits until its writer knows the client's reader
_MOST_BYTES = 4_000_000  # of a request
# Fields that `rmw_cyclonedds_cpp` adds to requests; replies repeat them.
_HEADER = ("uint64", "client", "int64", "request_number")
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
    """

    def __init__(self) -> None:
        self.messages: Any = MESSAGES
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
        receive = partial(self._receive, self._waits, self._end)  # `close` may not wait for its end
        self._thread = Thread(target=receive, name=name, daemon=True)
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

    def serve(self, service: str, kinds: tuple[Any, Any], answer: Callable[[Any], Any]) -> None:
        """Answer requests of nodes with `rmw_cyclonedds_cpp`, one at a time, from a thread.

        `kinds` are the classes of request and reply.
        """
        name, reliable = service.lstrip("/"), Policy.Reliability.Reliable(duration(seconds=1))
        qos = _qos(service, reliable, Policy.History.KeepLast(_QUEUE))
        topics = (f"rq/{name}Request", f"rr/{name}Reply")
        requests, replies = map(partial(Topic, self._participant), topics, kinds)
        reader = DataReader(self._participant, requests, qos=qos)
        writer = DataWriter(self._participant, replies, qos=qos)

        def take(request: Any) -> None:
            reply = answer(request)
            reply.client, reply.request_number = request.client, request.request_number
            end = time.monotonic() + _MATCHING
            clients = len(reader.get_matched_publications())
            while len(writer.get_matched_subscriptions()) < clients and time.monotonic() < end:
                time.sleep(0.005)
            writer.write(reply)

        self._readers.append((reader, kinds[0], take))
        self._waits.attach(ReadCondition(reader, _UNREAD))

    def senders(self, topic: str, kind: Any) -> int:
        """Return the number of publishers of a topic in other nodes that are known so far."""
        policies = Policy.Reliability.BestEffort, Policy.IgnoreLocal.Participant
        qos = _qos(topic, Policy.History.KeepLast(1), *policies)
        reader = DataReader(self._participant, self._topic(topic, kind), qos=qos)
        return len(reader.get_matched_publications())

    def check(self) -> None:
        """Do nothing: DDS has no master, and silence shows as the age of measurements."""

    def close(self) -> None:
        """Deliver what was sent and leave the domain; it may be called twice."""
        for publisher in self._publishers:
            publisher.flush()
        if self._thread is not None:
            self._end.set(True)
            self._thread.join(_ENDING)
        self._readers, self._publishers = [], []
        self._thread = self._waits = self._end = self._participant = None

    def _receive(self, waits: Any, end: Any) -> None:
        while not end.read():
            for reader, kind, take in tuple(self._readers):
                try:
                    for message in reader.take(1):  # one at a time: an invalid one loses no others
                        if isinstance(message, kind):  # not the notice of a sender that has gone
                            take(message)
                except Exception:  # noqa: BLE001 - the next message may be better
                    _log.exception("a message was dropped")
            waits.wait(duration(infinite=True))

    def _topic(self, name: str, kind: Any) -> Any:
        try:
            return Topic(self._participant, f"rt/{name.lstrip('/')}", kind)
        except DDSException as error:
            raise KinfeasError(f"{name!r} is no name of a topic: {error}") from error


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


def _from_sec(kind: Any, seconds: float) -> Any:
    whole = math.floor(seconds)
    carry, nanosec = divmod(round((seconds - whole) * _NANO), _NANO)
    return kind(whole + carry, nanosec)


def _to_sec(message: Any) -> float:
    return message.sec + message.nanosec / _NANO


def message_classes(file: str, known: Mapping[str, Any] | None = None) -> SimpleNamespace:
    """Return classes of messages, requests and replies by name, and the classes in `known`.

    Each line of `file`, which lies beside this module, is the name of a type in ROS, followed by
    the type and name of each field.
    """
    classes = dict(known or {})
    for line in Path(__file__).with_name(file).read_text(encoding="utf-8").splitlines():
        name, *fields = line.split()
        package, *folder, short = name.split("/")
        fields = [*(_HEADER if folder else ()), *fields]
        space: dict[str, Any] = {"__module__": __name__, "__annotations__": {}}
        for kind, key in zip(fields[::2], fields[1::2], strict=True):
            item, _, size = kind.rstrip("]").partition("[")
            idl, make = _PRIMITIVES.get(item) or [classes[item]] * 2
            if size.startswith("<="):
                idl, make = sequence[idl, int(size[2:])], list
            elif size:
                idl, make = array[idl, int(size)], partial(list, [make()] * int(size))
            elif kind != item:
                idl, make = sequence[idl], list
            space["__annotations__"][key], space[key] = idl, field(default_factory=make)
        if short == "Quaternion":
            space["w"] = 1.0
        if package == "builtin_interfaces":
            space |= {"from_sec": classmethod(_from_sec), "to_sec": _to_sec}
        if folder:
            space["deserialize"] = classmethod(_deserialize)
        typename = {"typename": f"{package}::{'srv' if folder else 'msg'}::dds_::{short}_"}
        fill = partial(dict.update, **space)  # of the namespace of the class
        classes[short] = dataclass(new_class(short, (IdlStruct,), typename, fill))
    return SimpleNamespace(**classes)


def _deserialize(kind: Any, data: bytes) -> Any:
    if len(data) > _MOST_BYTES:
        raise ValueError(f"a message of {len(data)} bytes is longer than {_MOST_BYTES}")
    return kind.__idl__.deserialize(data)


_PRIMITIVES: dict[str, Any] = {
    "string": (str, str), "bool": (bool, bool), "int8": (int8, int), "uint8": (uint8, int),
    "int32": (int32, int), "uint32": (uint32, int), "int64": (int64, int), "uint64": (uint64, int),
    "float32": (float32, float), "float64": (float64, float),
}  # fmt: skip

MESSAGES = message_classes("messages.txt")
"""Message classes by name."""
