"""What stops the base of a robot on ROS from another process than the one that drives it."""

import time
from collections.abc import Callable

from kinfeas.core.errors import KinfeasError
from kinfeas.sim2real.ros.bus import Version, make_bus

_SETTLED = 0.05  # s; a connection is counted a little before it carries anything


def stop_base(
    version: Version, topic: str, *, stamped: bool = False, patience: float = 10.0
) -> Callable[[], None]:
    """Return a function that commands the base to zero over a connection that stands already.

    Such a connection leads from one process to the other and outlives the master of ROS 1. The
    function raises Fault where nothing can be sent any more.

    Args:
        version: Of ROS.
        topic: Of geometry_msgs/Twist.
        stamped: Whether it is of TwistStamped instead.
        patience: For how many seconds to wait until somebody listens to it.

    Raises:
        KinfeasError: If there is no ROS to connect to, or nobody listens.
    """
    bus = make_bus(version)
    bus.open("kinfeas_watchdog")
    twist = bus.messages.TwistStamped if stamped else bus.messages.Twist
    command, end = bus.publisher(topic, twist), time.monotonic() + patience
    while not command.listeners():
        if time.monotonic() > end:
            raise KinfeasError(f"nobody listens to {topic} within {patience:g} s")
        time.sleep(0.02)
    time.sleep(_SETTLED)

    def stop() -> None:
        bus.check_sending()
        zero = twist()
        if stamped:  # or a robot might take it for one of long ago
            zero.header.stamp = bus.messages.Time.from_sec(time.time())
        command.publish(zero)

    return stop
