"""What stops the base of a robot on ROS 1 from another process than the one that drives it."""

import time
from collections.abc import Callable

from kinfeas.errors import KinfeasError
from kinfeas.sim2real.ros1_node import flush, publisher, ros, start_node


def stop_base(topic: str, patience: float = 10.0) -> Callable[[], None]:
    """Return a function that commands the base to zero over a connection that stands already.

    Such a connection leads from one process to the other and outlives the ROS master.

    Args:
        topic: Of geometry_msgs/Twist.
        patience: For how many seconds to wait until somebody listens to it.

    Raises:
        KinfeasError: If there is no ROS master, or nobody listens.
    """
    start_node("kinfeas_watchdog")
    twist = ros("geometry_msgs.msg").Twist
    command, end = publisher(topic, twist), time.monotonic() + patience
    while not command.get_num_connections():
        if time.monotonic() > end:
            raise KinfeasError(f"nobody listens to {topic} within {patience:g} s")
        time.sleep(0.02)
    flush()  # the connection is counted a little before it carries anything
    return lambda: command.publish(twist())
