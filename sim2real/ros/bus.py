"""The interface to one version of ROS: message classes, topics, and the stop of the watchdog.

The process of the watchdog imports this module; it must import neither numpy nor ROS.
"""

import time
from collections.abc import Callable
from typing import Any, Literal, Protocol

from kinfeas.core.errors import KinfeasError

Version = Literal[1, 2]
"""Version of ROS."""

_SETTLING = 0.05  # s until a connection that ROS already counts carries messages


class Publisher(Protocol):
    """The sender of a topic."""

    def publish(self, message: Any) -> None:
        """Send a message without blocking; it replaces one that is not sent yet.

        Raises Fault if messages are not sent any more.
        """

    def listeners(self) -> int:
        """Return the number of subscribers."""


class RosBus(Protocol):
    """A node in this process.

    Attributes:
        messages: Message classes by their names, after `open`; both versions have the same fields.
            `Time` and `Duration` have `from_sec` and `to_sec`.
    """

    messages: Any

    def open(self, name: str) -> None:
        """Start a node whose name begins with `name`; raise KinfeasError if that fails."""

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return the sender of a topic with messages of the class `kind`."""

    def subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], *, every: bool = False
    ) -> None:
        """Pass messages to `take`, from any thread: `every` one, or the newest."""

    def senders(self, topic: str, kind: Any) -> int:
        """Return the number of publishers of a topic in other nodes that are known so far."""

    def check(self) -> None:
        """Raise Fault if the connection is broken."""

    def close(self) -> None:
        """Deliver what was sent and release the topics; it may be called twice."""


def make_bus(version: Version) -> RosBus:
    """Return a bus that is not open yet."""
    if version == 1:
        from kinfeas.sim2real.ros.ros1 import Ros1Bus

        return Ros1Bus()
    from kinfeas.sim2real.ros.ros2 import Ros2Bus

    return Ros2Bus()


def stop_base(
    version: Version, topic: str, *, stamped: bool = False, timeout: float = 10.0
) -> Callable[[], None]:
    """Return a function that commands zero velocity, or raises Fault, over its own connection.

    The connection is from process to process and does not need the master of ROS 1. The topic is of
    geometry_msgs/Twist, or TwistStamped if `stamped`. Raises KinfeasError if it has no subscriber
    within `timeout` seconds.
    """
    bus = make_bus(version)
    bus.open("kinfeas_watchdog")
    twist = bus.messages.TwistStamped if stamped else bus.messages.Twist
    command, end = bus.publisher(topic, twist), time.monotonic() + timeout
    while not command.listeners():
        if time.monotonic() > end:
            raise KinfeasError(f"{topic} has no subscriber within {timeout:g} s")
        time.sleep(0.02)
    time.sleep(_SETTLING)

    def stop() -> None:
        zero = twist()
        if stamped:  # robots ignore old commands
            zero.header.stamp = bus.messages.Time.from_sec(time.time())
        command.publish(zero)

    return stop
