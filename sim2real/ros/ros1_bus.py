"""ROS 1 as a bus: topics of a node in this process, and a watch on the master."""

from collections.abc import Callable
from typing import Any

from kinfeas.sim2real.link.fault import Fault
from kinfeas.sim2real.ros.bus import Messages, Publisher
from kinfeas.sim2real.ros.ros1_node import MasterWatch, flush, let_go, publisher, ros, start_node


class Ros1Bus:
    """Topics of ROS 1.

    Attributes:
        messages: Classes of messages, once it is open.
    """

    messages: Messages

    def __init__(self) -> None:
        """Connect nothing yet."""
        self._master: MasterWatch | None = None
        self._topics: list[Any] = []

    def open(self, name: str) -> None:
        """Make this process a node; raise KinfeasError if there is no ROS 1 or no master."""
        start_node(name)
        self._master, self.messages = MasterWatch(), ros1_message_classes()

    def publisher(self, topic: str, kind: Any) -> Publisher:
        """Return what sends the newest message without delay."""
        made = publisher(topic, kind)
        self._topics.append(made)
        return _Ros1Publisher(made)

    def subscribe(
        self, topic: str, kind: Any, take: Callable[[Any], None], *, every: bool = False
    ) -> None:
        """Hand the messages of a topic on, from a thread: `every` one, or the newest."""
        queue = None if every else 1
        subscriber = ros("rospy").Subscriber(topic, kind, take, queue_size=queue, tcp_nodelay=True)
        self._topics.append(subscriber)

    def check(self) -> None:
        """Do nothing while node and master live; raise Fault if not."""
        self.check_sending()
        if self._master is not None:
            self._master.check()

    def check_sending(self) -> None:
        """Raise Fault if this node was shut down: what it publishes then is silently lost."""
        if ros("rospy").is_shutdown():
            raise Fault("this node was shut down, as rosnode kill does it")

    def close(self) -> None:
        """Deliver what was sent and let go of the topics; the node lives on."""
        if self._master is None:
            return
        flush()
        let_go(self._master, self._topics)
        self._master, self._topics = None, []


class _Ros1Publisher:
    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def publish(self, message: Any) -> None:
        self._publisher.publish(message)

    def listeners(self) -> int:
        count: int = self._publisher.get_num_connections()
        return count


def ros1_message_classes() -> Messages:
    """Return the classes of messages of ROS 1; raise KinfeasError if one is not installed."""
    geometry, trajectory, rospy = ros("geometry_msgs.msg"), ros("trajectory_msgs.msg"), ros("rospy")
    # Debian has no package of PR2's messages; this one is made of two numbers.
    gripper = "pr2_controllers_msgs/Pr2GripperCommand"
    made = ros("genpy.dynamic").generate_dynamic(gripper, "float64 position\nfloat64 max_effort\n")
    return Messages(
        Twist=geometry.Twist,
        TwistStamped=geometry.TwistStamped,
        Odometry=ros("nav_msgs.msg").Odometry,
        JointState=ros("sensor_msgs.msg").JointState,
        JointTrajectory=trajectory.JointTrajectory,
        JointTrajectoryPoint=trajectory.JointTrajectoryPoint,
        TFMessage=ros("tf2_msgs.msg").TFMessage,
        TransformStamped=geometry.TransformStamped,
        Time=rospy.Time,
        Duration=rospy.Duration,
        Pr2GripperCommand=made[gripper],
    )
