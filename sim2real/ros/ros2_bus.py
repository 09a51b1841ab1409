"""ROS 2 as a bus: its topics are DDS topics, so that no ROS has to be on this machine.

ROS 2 calls the topic `/joint_states` `rt/joint_states` on DDS, and its messages there have types
such as `sensor_msgs::msg::dds_::JointState_` in the representation XCDR 1
(https://design.ros2.org/articles/topic_and_service_names.html).
"""

import os
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.link.fault import Fault
from kinfeas.sim2real.ros.bus import Messages, Publisher

_DOMAINS = 232
"""The last domain whose ports are free on Linux."""

_BLOCKS_MS = 5
"""For how long a command may wait for a place in the sender's queue, which holds the newest."""

_DELIVERED_MS = 50
"""For how long to wait at the end until all is delivered."""

_MANY = 100
"""Messages that wait for their reader where every one counts."""

_KEPT = "/tf_static"
"""The topic whose messages are for those, too, who come later."""

_LOCAL = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    "<Peers><Peer Address='localhost'/></Peers></Discovery></Domain></CycloneDDS>"
)


class Ros2Bus:
    """Topics of ROS 2, by Eclipse Cyclone DDS.

    `ROS_DOMAIN_ID` and `CYCLONEDDS_URI` count as for any node; with `ROS_LOCALHOST_ONLY=1` or
    `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` nothing leaves this machine.

    Attributes:
        messages: Classes of messages, once it is open.
    """

    messages: Messages

    def __init__(self) -> None:
        """Connect nothing yet."""
        self._participant: Any = None
        self._publishers: list[_Ros2Publisher] = []
        self._readers: list[Any] = []

    def open(self, name: str) -> None:
        """Take part in the domain; raise KinfeasError if there is no DDS or no such domain."""
        domain = _domain()
        try:
            from cyclonedds.core import DDSException, Policy, Qos
            from cyclonedds.domain import DomainParticipant
        except ImportError as error:
            raise KinfeasError(
                "ROS 2 is reached by DDS, which is not installed: pip install 'kinfeas[ros2]'"
            ) from error
        if _stays_here():
            os.environ.setdefault("CYCLONEDDS_URI", _LOCAL)
        try:
            self._participant = DomainParticipant(domain, qos=Qos(Policy.EntityName(name)))
        except DDSException as error:
            uri = os.environ.get("CYCLONEDDS_URI")
            set_up = f" with CYCLONEDDS_URI={uri}" if uri else ""
            raise KinfeasError(f"DDS cannot join domain {domain}{set_up}: {error}") from error
        self.messages = ros2_message_classes()

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return what sends the newest message without delay."""
        from cyclonedds.core import Policy
        from cyclonedds.pub import DataWriter
        from cyclonedds.util import duration

        blocks = Policy.Reliability.Reliable(duration(milliseconds=_BLOCKS_MS))
        qos = _qos(topic, blocks, Policy.History.KeepLast(1))
        writer = DataWriter(self._participant, self._topic(topic, kind), qos=qos)
        made = _Ros2Publisher(topic, writer)
        self._publishers.append(made)
        return made

    def subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], *, every: bool = False
    ) -> None:
        """Hand the messages of a topic on, from a thread: `every` one, or the newest."""
        from cyclonedds.core import Listener, Policy
        from cyclonedds.sub import DataReader
        from cyclonedds.util import duration

        # Who asks for little is served by all senders.
        policies = [Policy.Reliability.BestEffort, Policy.History.KeepLast(1)]
        if every:
            reliable = Policy.Reliability.Reliable(duration(milliseconds=_BLOCKS_MS))
            policies = [reliable, Policy.History.KeepLast(_MANY)]
        reader = DataReader(self._participant, self._topic(topic, kind), qos=_qos(topic, *policies))
        self._readers.append(reader)

        def hand_on(_: object) -> None:
            for message in reader.take(_MANY):
                if isinstance(message, kind):  # and no notice that a sender has gone
                    take(message)

        reader.set_listener(Listener(on_data_available=hand_on))
        hand_on(reader)  # what came before

    def check(self) -> None:
        """Do nothing: there is no master that could die, and silence shows as age."""

    def check_sending(self) -> None:
        """Do nothing: a sender whose queue is full says so itself."""

    def close(self) -> None:
        """Deliver what was sent and leave the domain; it may be called twice."""
        for publisher in self._publishers:
            publisher.flush()
        for reader in self._readers:
            reader.set_listener(None)
        self._readers, self._publishers, self._participant = [], [], None

    def _topic(self, name: str, kind: Any) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self._participant, f"rt/{name.lstrip('/')}", kind)


class _Ros2Publisher:
    def __init__(self, topic: str, writer: Any) -> None:
        self._name, self._writer = topic, writer

    def publish(self, message: Any) -> None:
        from cyclonedds.core import DDSException

        try:
            self._writer.write(message)
        except DDSException as error:
            raise Fault(f"nothing can be sent to {self._name} any more: {error}") from error

    def listeners(self) -> int:
        return len(self._writer.get_matched_subscriptions())

    def flush(self) -> None:
        from cyclonedds.util import duration

        with suppress(AttributeError):  # cyclonedds 0.10 misspells the constant of its time-out
            self._writer.wait_for_acks(duration(milliseconds=_DELIVERED_MS))


def _qos(topic: str, *policies: Any) -> Any:
    """Return how a topic is carried: as ROS 2 writes messages, and kept where it keeps them."""
    from cyclonedds.core import Policy, Qos

    kept = Policy.Durability.TransientLocal if topic == _KEPT else Policy.Durability.Volatile
    return Qos(Policy.DataRepresentation(use_cdrv0_representation=True), kept, *policies)


def _domain() -> int:
    """Return the domain that ROS_DOMAIN_ID names."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isdecimal() and int(text) <= _DOMAINS):
        raise KinfeasError(f"ROS_DOMAIN_ID must be a number from 0 to {_DOMAINS}, not {text!r}")
    return int(text)


def _stays_here() -> bool:
    only = os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    return only or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "LOCALHOST"


def ros2_message_classes() -> Messages:
    """Return the classes of messages of ROS 2, for which DDS must be there."""
    from kinfeas.sim2real.ros import ros2_messages as own

    return Messages(
        Twist=own.Twist,
        TwistStamped=own.TwistStamped,
        Odometry=own.Odometry,
        JointState=own.JointState,
        JointTrajectory=own.JointTrajectory,
        JointTrajectoryPoint=own.JointTrajectoryPoint,
        TFMessage=own.TFMessage,
        TransformStamped=own.TransformStamped,
        Time=own.Time,
        Duration=own.Duration,
    )
