"""Our end of the topics of a robot on ROS, of either version."""

import time
from collections.abc import Mapping
from typing import Any

from kinfeas.core.backend import Grip
from kinfeas.core.spatial import Array
from kinfeas.sim2real.link import Readings
from kinfeas.sim2real.link.fault import Fault
from kinfeas.sim2real.link.stamps import DRIFT
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros.bus import Publisher, RosBus
from kinfeas.sim2real.ros.names import Topics
from kinfeas.sim2real.ros.tf import TfTree


class RosLink:
    """Commands base, arm and gripper, and listens to odometry or TF and to joint states.

    Attributes:
        base_source: Topic or transform of the base's pose.
        joint_source: Topic of joint positions.
    """

    def __init__(self, topics: Topics, bus: RosBus, drift: float = DRIFT) -> None:
        """Set out the names; `open` connects. The robot's clock may be slower by `drift`."""
        base = topics.base
        tf = f"/tf ({base.world_frame} to {base.frame})"
        self.base_source = base.odometry if base.measured_by == "odometry" else tf
        self.joint_source = topics.joints.measured
        self._topics, self._bus, self._drift = topics, bus, drift
        self._publishers: dict[str, Publisher] = {}
        self._frame_fault: str | None = None

    def open(self, readings: Readings) -> None:
        """Connect; raise KinfeasError if there is no ROS to connect to."""
        self._bus.open("kinfeas")
        self._frame_fault = None
        topics, messages = self._topics, self._bus.messages
        base = messages.TwistStamped if topics.base.stamped else messages.Twist
        kinds = {topics.base.command: base}
        kinds |= {one.command: messages.JointTrajectory for one in topics.joints.controllers}
        if topics.gripper is not None:
            kinds[topics.gripper.command] = ros_messages.gripper_type(messages, topics.gripper)
        self._publishers = {
            topic: self._bus.publisher(topic, kind) for topic, kind in kinds.items()
        }
        self._listen_to_joints(readings)
        if topics.base.measured_by == "odometry":
            self._listen_to_odometry(readings)
        else:
            self._listen_to_tf(readings)

    def waits_for(self) -> str | None:
        """Return the first topic to which nobody listens yet; a gripper may be missing."""
        topics = self._topics
        wanted = [topics.base.command, *(one.command for one in topics.joints.controllers)]
        silent = (one for one in wanted if not self._publishers[one].listeners())
        return next(silent, None)

    def check(self) -> None:
        """Do nothing while the connection holds and the robot's frames are the expected ones.

        Raises:
            Fault: If not.
        """
        self._bus.check()
        if self._frame_fault is not None:
            raise Fault(self._frame_fault)

    def drive(self, velocity: Array) -> None:
        """Command the base: x, y and turning in its own frame, shape (3,), m/s and rad/s."""
        base = self._topics.base
        stamp = time.time() if base.stamped else None
        self._send(base.command, ros_messages.drive_command(self._bus.messages, velocity, stamp))

    def move(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send each controller its share of the joints."""
        for one in self._topics.joints.controllers:
            share = {name: positions[name] for name in one.joints}
            self._send(one.command, ros_messages.trajectory(self._bus.messages, share, seconds))

    def grip(self, grip: Grip) -> None:
        """Begin to close or to open the gripper, if the file names one."""
        gripper = self._topics.gripper
        if gripper is not None:
            message = ros_messages.gripper_command(self._bus.messages, gripper, grip)
            self._send(gripper.command, message)

    def close(self) -> None:
        """Deliver what was sent and let go of the topics; it may be called twice."""
        self._bus.close()

    def _send(self, topic: str, message: Any) -> None:
        self._bus.check_sending()
        self._publishers[topic].publish(message)

    def _listen_to_joints(self, readings: Readings) -> None:
        def take(message: Any) -> None:
            reading = ros_messages.from_joint_state(message)
            if reading is not None:
                readings.joints(reading)

        self._bus.subscribe(self.joint_source, self._bus.messages.JointState, take)

    def _listen_to_odometry(self, readings: Readings) -> None:
        frame = self._topics.base.frame.lstrip("/")

        def take(message: Any) -> None:
            theirs = message.child_frame_id.lstrip("/")
            if theirs not in ("", frame):
                self._frame_fault = (
                    f"{self.base_source} measures {theirs}, but the base's frame is {frame}"
                )
            readings.base(ros_messages.from_odometry(message))

        self._bus.subscribe(self.base_source, self._bus.messages.Odometry, take)

    def _listen_to_tf(self, readings: Readings) -> None:
        base = self._topics.base
        tree = TfTree(base.world_frame, base.frame, self._drift)
        kind = self._bus.messages.TFMessage

        def take(message: Any) -> None:
            tree.take(message)
            reading = tree.reading()
            if reading is not None:
                readings.base(reading)

        def take_static(message: Any) -> None:
            tree.take(message, static=True)

        # Of transforms, every message counts: each has others.
        self._bus.subscribe("/tf", kind, take, every=True)
        self._bus.subscribe("/tf_static", kind, take_static, every=True)
