"""The backend `ros1`: a robot, or what plays one, behind the topics of ROS 1."""

from collections.abc import Mapping
from typing import Any

from kinfeas.backend import Grip
from kinfeas.robots.robot import Robot
from kinfeas.sim2real import ros1_messages as messages
from kinfeas.sim2real.fault import Fault
from kinfeas.sim2real.link import Readings, RobotLink
from kinfeas.sim2real.link_backend import LinkBackend
from kinfeas.sim2real.ros1_names import Topics, read_topics
from kinfeas.sim2real.ros1_node import (
    MasterWatch,
    flush,
    let_go,
    publisher,
    ros,
    start_node,
    subscriber,
)
from kinfeas.sim2real.ros1_tf import TfTree
from kinfeas.sim2real.watchdog import StopCall
from kinfeas.spatial import Array


class Ros1Backend(LinkBackend):
    """One robot behind the topics of ROS 1."""

    def __init__(
        self,
        robot: Robot,
        topics: str | None = None,
        *,
        seconds: float = 0.1,
        patience: float = 5.0,
        stale: float = 0.2,
    ) -> None:
        """Connect nothing yet: `reset` does.

        Args:
            robot: Robot at the other end.
            topics: Path of a YAML file with its names, or the name of one that comes with the
                package; the robot's own name by default.
            seconds: In which the arm shall reach each target: time_from_start of its points.
            patience: For how many seconds `reset` waits for the first measurements.
            stale: As in `LinkBackend`, seconds.

        Raises:
            KinfeasError: If the file is broken, or a duration is not above 0 and finite.
        """
        self.topics = read_topics(robot, topics)
        names = self.topics.joints.names
        link = Ros1Link(self.topics)
        super().__init__(robot, link, names=names, seconds=seconds, patience=patience, stale=stale)

    def stop_call(self) -> StopCall:
        """Return what the watchdog calls."""
        topic = self.topics.base.command
        return StopCall("kinfeas.sim2real.ros1_stop:stop_base", {"topic": topic})

    @staticmethod
    def robot_link(robot: Robot, topics: str | None = None) -> RobotLink:
        """Return the robot's end, for what plays a robot; arguments as in `Hosted`."""
        from kinfeas.sim2real.ros1_robot import Ros1RobotLink

        return Ros1RobotLink(robot, read_topics(robot, topics))


class Ros1Link:
    """Our end of the topics.

    Attributes:
        base_source: Topic or transform of the base's pose.
        joint_source: Topic of joint positions.
    """

    def __init__(self, topics: Topics) -> None:
        """Set out the names; `open` connects."""
        base = topics.base
        tf = f"/tf ({base.world_frame} to {base.frame})"
        self.base_source = base.odometry if base.measured_by == "odometry" else tf
        self.joint_source = topics.joints.measured
        self._topics = topics
        self._master: MasterWatch | None = None
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []
        self._frame_fault: str | None = None

    def open(self, readings: Readings) -> None:
        """Connect; raise KinfeasError if there is no ROS or no master."""
        start_node("kinfeas")
        self._master, self._frame_fault = MasterWatch(), None
        topics, trajectory = self._topics, ros("trajectory_msgs.msg").JointTrajectory
        kinds = {topics.base.command: ros("geometry_msgs.msg").Twist}
        kinds |= {one.command: trajectory for one in topics.joints.controllers}
        if topics.gripper is not None:
            kinds[topics.gripper.command] = messages.gripper_type(topics.gripper)
        self._publishers = {topic: publisher(topic, kind) for topic, kind in kinds.items()}
        state = ros("sensor_msgs.msg").JointState
        self._subscribers = [subscriber(self.joint_source, state, _joints(readings))]
        if topics.base.measured_by == "odometry":
            self._listen_to_odometry(readings)
        else:
            self._listen_to_tf(readings)

    def waits_for(self) -> str | None:
        """Return the first topic to which nobody listens yet; a gripper may be missing."""
        topics = self._topics
        wanted = [topics.base.command, *(one.command for one in topics.joints.controllers)]
        silent = (one for one in wanted if not self._publishers[one].get_num_connections())
        return next(silent, None)

    def check(self) -> None:
        """Do nothing while node and master live and the robot's frames are the expected ones.

        Raises:
            Fault: If not.
        """
        _check_node()
        if self._master is not None:
            self._master.check()
        if self._frame_fault is not None:
            raise Fault(self._frame_fault)

    def drive(self, velocity: Array) -> None:
        """Command the base: x, y and turning in its own frame, shape (3,), m/s and rad/s."""
        _check_node()
        self._publishers[self._topics.base.command].publish(messages.twist(velocity))

    def move(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send each controller its share of the joints."""
        _check_node()
        for one in self._topics.joints.controllers:
            share = {name: positions[name] for name in one.joints}
            self._publishers[one.command].publish(messages.trajectory(share, seconds))

    def grip(self, grip: Grip) -> None:
        """Begin to close or to open the gripper, if the file names one."""
        gripper = self._topics.gripper
        if gripper is not None:
            self._publishers[gripper.command].publish(messages.gripper_command(gripper, grip))

    def close(self) -> None:
        """Deliver what was sent and let go of the topics; the node lives on."""
        if self._master is None:
            return
        flush()
        let_go(self._master, (*self._publishers.values(), *self._subscribers))
        self._master = None

    def _listen_to_odometry(self, readings: Readings) -> None:
        frame = self._topics.base.frame.lstrip("/")

        def take(message: Any) -> None:
            theirs = message.child_frame_id.lstrip("/")
            if theirs not in ("", frame):
                self._frame_fault = (
                    f"{self.base_source} measures {theirs}, but the base's frame is {frame}"
                )
            readings.base(messages.from_odometry(message))

        odometry = ros("nav_msgs.msg").Odometry
        self._subscribers.append(subscriber(self.base_source, odometry, take))

    def _listen_to_tf(self, readings: Readings) -> None:
        base = self._topics.base
        tree, kind = TfTree(base.world_frame, base.frame), ros("tf2_msgs.msg").TFMessage

        def take(message: Any) -> None:
            tree.take(message)
            reading = tree.reading()
            if reading is not None:
                readings.base(reading)

        def take_static(message: Any) -> None:
            tree.take(message, static=True)

        rospy = ros("rospy")
        # Of transforms, every message counts: each has others.
        self._subscribers.append(rospy.Subscriber("/tf", kind, take, tcp_nodelay=True))
        self._subscribers.append(rospy.Subscriber("/tf_static", kind, take_static))


def _check_node() -> None:
    """Raise Fault if this node was shut down: from then on what is published is silently lost."""
    if ros("rospy").is_shutdown():
        raise Fault("this node was shut down, as rosnode kill does it")


def _joints(readings: Readings) -> Any:
    def take(message: Any) -> None:
        reading = messages.from_joint_state(message)
        if reading is not None:
            readings.joints(reading)

    return take
