"""The robot's end of the topics of ROS, of either version, for what plays a robot."""

import time
from typing import Any

import numpy as np

from kinfeas.sim2real.link import BaseReading, JointReading, Orders
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros.bus import RosBus
from kinfeas.sim2real.ros.names import GripperTopics, Topics

_ODOM = "odom"


class RosRobotLink:
    """Listens to commands and publishes odometry, joint states and TF (map, odom, base)."""

    def __init__(self, topics: Topics, bus: RosBus) -> None:
        """Set out the names; `open` connects."""
        self._topics, self._bus = topics, bus

    def open(self, orders: Orders) -> None:
        """Connect; raise KinfeasError if there is no ROS to connect to."""
        bus, topics = self._bus, self._topics
        bus.open("kinfeas_robot")
        messages = bus.messages
        base = messages.TwistStamped if topics.base.stamped else messages.Twist
        bus.subscribe(topics.base.command, base, _drive(orders))
        for one in topics.joints.controllers:
            bus.subscribe(one.command, messages.JointTrajectory, _move(orders))
        if topics.gripper is not None:
            kind = ros_messages.gripper_type(messages, topics.gripper)
            bus.subscribe(topics.gripper.command, kind, _grip(orders, topics.gripper))
        self._odometry = bus.publisher(topics.base.odometry, messages.Odometry)
        self._joints = bus.publisher(topics.joints.measured, messages.JointState)
        self._tf = bus.publisher("/tf", messages.TFMessage)

    def check(self) -> None:
        """Do nothing while the connection holds; raise Fault if it broke."""
        self._bus.check()

    def report(self, base: BaseReading, joints: JointReading) -> None:
        """Publish a measurement."""
        now = time.time() if base.stamp is None else base.stamp
        stamp = self._bus.messages.Time.from_sec(now)
        self._odometry.publish(self._odometry_of(base, stamp))
        self._joints.publish(self._joint_state(joints, stamp))
        world, frame = self._topics.base.world_frame, self._topics.base.frame
        message, rest = self._bus.messages.TFMessage(), BaseReading(0.0, 0.0, 0.0)
        message.transforms = [
            self._transform(world, _ODOM, rest, stamp),
            self._transform(_ODOM, frame, base, stamp),
        ]
        self._tf.publish(message)

    def close(self) -> None:
        """Let go of the topics; it may be called twice."""
        self._bus.close()

    def _odometry_of(self, base: BaseReading, stamp: Any) -> Any:
        message = self._bus.messages.Odometry()
        message.header.stamp, message.header.frame_id = stamp, _ODOM
        message.child_frame_id = self._topics.base.frame
        pose = message.pose.pose
        pose.position.x, pose.position.y = base.x, base.y
        pose.orientation.z, pose.orientation.w = _half(base.yaw)
        if base.velocity is not None:
            ros_messages.fill_twist(message.twist.twist, base.velocity)
        return message

    def _joint_state(self, joints: JointReading, stamp: Any) -> Any:
        message, names = self._bus.messages.JointState(), self._topics.joints.names
        message.header.stamp = stamp
        message.name = [names.get(name, name) for name in joints.positions]
        message.position = list(joints.positions.values())
        message.velocity = [joints.velocities.get(name, 0.0) for name in joints.positions]
        return message

    def _transform(self, parent: str, child: str, base: BaseReading, stamp: Any) -> Any:
        message = self._bus.messages.TransformStamped()
        message.header.stamp, message.header.frame_id = stamp, parent
        message.child_frame_id = child
        place, turn = message.transform.translation, message.transform.rotation
        place.x, place.y = base.x, base.y
        turn.z, turn.w = _half(base.yaw)
        return message


def _half(yaw: float) -> tuple[float, float]:
    return float(np.sin(yaw / 2.0)), float(np.cos(yaw / 2.0))


def _drive(orders: Orders) -> Any:
    def take(message: Any) -> None:
        velocity = ros_messages.velocity(message)
        if np.isfinite(velocity).all():
            orders.drive(velocity)

    return take


def _move(orders: Orders) -> Any:
    def take(message: Any) -> None:
        way = ros_messages.path(message)
        if way is not None:
            orders.move(way)

    return take


def _grip(orders: Orders, gripper: GripperTopics) -> Any:
    def take(message: Any) -> None:
        grip = ros_messages.from_gripper(gripper, message)
        if grip is not None:
            orders.grip(grip)

    return take
