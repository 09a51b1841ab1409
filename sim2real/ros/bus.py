"""What links over ROS need of one of its two versions: messages, and topics to carry them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

Version = Literal[1, 2]
"""Of ROS."""


@dataclass(frozen=True)
class Messages:
    """Classes of messages, made without arguments; both versions of ROS name their fields alike.

    `Time` and `Duration` have `from_sec` and `to_sec`. PR2's gripper speaks ROS 1 alone.
    """

    Twist: Any
    TwistStamped: Any
    Odometry: Any
    JointState: Any
    JointTrajectory: Any
    JointTrajectoryPoint: Any
    TFMessage: Any
    TransformStamped: Any
    Time: Any
    Duration: Any
    Pr2GripperCommand: Any = None


class Publisher(Protocol):
    """One topic, as its sender sees it."""

    def publish(self, message: Any) -> None:
        """Send a message without waiting for anybody; the newest one counts."""
        ...

    def listeners(self) -> int:
        """Return how many listen."""
        ...


class RosBus(Protocol):
    """A node of its own in this process, with the topics that it opens.

    Attributes:
        messages: Classes of messages, once it is open.
    """

    messages: Messages

    def open(self, name: str) -> None:
        """Connect as a node whose name begins with `name`.

        Raises:
            KinfeasError: If this version of ROS is not installed, or there is nothing to connect
                to.
        """
        ...

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return what sends messages of a class to a topic."""
        ...

    def subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], *, every: bool = False
    ) -> None:
        """Hand the messages of a topic on, from any thread: `every` one, or the newest."""
        ...

    def check(self) -> None:
        """Do nothing while the connection holds.

        Raises:
            Fault: If it is broken.
        """
        ...

    def check_sending(self) -> None:
        """Do nothing while what is published is carried; cheap enough for every command.

        Raises:
            Fault: If it is not.
        """
        ...

    def close(self) -> None:
        """Deliver what was sent and let go of the topics; it may be called twice."""
        ...


def make_bus(version: Version) -> RosBus:
    """Return a bus of a version of ROS that is not open yet."""
    if version == 1:
        from kinfeas.sim2real.ros.ros1_bus import Ros1Bus

        return Ros1Bus()
    from kinfeas.sim2real.ros.ros2_bus import Ros2Bus

    return Ros2Bus()
