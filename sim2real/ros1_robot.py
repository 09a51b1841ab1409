"""The robot's end of the topics of ROS 1, for what plays a robot."""

import time
from typing import Any

import numpy as np

from kinfeas.robots.robot import Robot
from kinfeas.sim2real import ros1_messages as messages
from kinfeas.sim2real.link import BaseReading, JointReading, Orders
from kinfeas.sim2real.ros1_names import Topics
from kinfeas.sim2real.ros1_node import MasterWatch, let_go, publisher, ros, start_node, subscriber

_ODOM = "odom"


class Ros1RobotLink:
    """Listens to commands and publishes odometry, joint states and TF (map, odom, base)."""

    def __init__(self, robot: Robot, topics: Topics) -> None:
        """Set out the names; `open` connects."""
        self._robot, self._topics = robot, topics
        self._names = topics.joints.names
        self._master: MasterWatch | None = None
        self._subscribers: list[Any] = []

    def open(self, orders: Orders) -> None:
        """Connect; raise KinfeasError if there is no ROS or no master."""
        start_node("kinfeas_robot")
        self._master = MasterWatch()
        topics = self._topics
        twist, path = ros("geometry_msgs.msg").Twist, ros("trajectory_msgs.msg").JointTrajectory
        self._subscribers = [subscriber(topics.base.command, twist, _drive(orders))]
        self._subscribers += [
            subscriber(one.command, path, _move(orders)) for one in topics.joints.controllers
        ]
        if topics.gripper is not None:
            kind = messages.gripper_type(topics.gripper)
            take = _grip(orders, topics)
            self._subscribers.append(subscriber(topics.gripper.command, kind, take))
        self._odometry = publisher(topics.base.odometry, ros("nav_msgs.msg").Odometry)
        self._joints = publisher(topics.joints.measured, ros("sensor_msgs.msg").JointState)
        self._tf = publisher("/tf", ros("tf2_msgs.msg").TFMessage)

    def check(self) -> None:
        """Do nothing while the master lives; raise Fault if it died."""
        if self._master is not None:
            self._master.check()

    def report(self, base: BaseReading, joints: JointReading) -> None:
        """Publish a measurement."""
        stamp = ros("rospy").Time.from_sec(time.time() if base.stamp is None else base.stamp)
        self._odometry.publish(self._odometry_of(base, stamp))
        message = ros("sensor_msgs.msg").JointState()
        message.header.stamp = stamp
        message.name = [self._names.get(name, name) for name in joints.positions]
        message.position = list(joints.positions.values())
        message.velocity = [joints.velocities.get(name, 0.0) for name in joints.positions]
        self._joints.publish(message)
        world, frame = self._topics.base.world_frame, self._topics.base.frame
        rest, here = BaseReading(0.0, 0.0, 0.0), base
        edges = [_transform(world, _ODOM, rest, stamp), _transform(_ODOM, frame, here, stamp)]
        self._tf.publish(ros("tf2_msgs.msg").TFMessage(edges))

    def close(self) -> None:
        """Let go of the topics; it may be called twice."""
        if self._master is None:
            return
        let_go(self._master, (*self._subscribers, self._odometry, self._joints, self._tf))
        self._master = None

    def _odometry_of(self, base: BaseReading, stamp: Any) -> Any:
        message = ros("nav_msgs.msg").Odometry()
        message.header.stamp, message.header.frame_id = stamp, _ODOM
        message.child_frame_id = self._topics.base.frame
        pose = message.pose.pose
        pose.position.x, pose.position.y = base.x, base.y
        pose.orientation.z, pose.orientation.w = _half(base.yaw)
        if base.velocity is not None:
            message.twist.twist = messages.twist(base.velocity)
        return message


def _transform(parent: str, child: str, base: BaseReading, stamp: Any) -> Any:
    message = ros("geometry_msgs.msg").TransformStamped()
    message.header.stamp, message.header.frame_id = stamp, parent
    message.child_frame_id = child
    message.transform.translation.x, message.transform.translation.y = base.x, base.y
    message.transform.rotation.z, message.transform.rotation.w = _half(base.yaw)
    return message


def _half(yaw: float) -> tuple[float, float]:
    return float(np.sin(yaw / 2.0)), float(np.cos(yaw / 2.0))


def _drive(orders: Orders) -> Any:
    def take(message: Any) -> None:
        velocity = np.array([message.linear.x, message.linear.y, message.angular.z])
        if np.isfinite(velocity).all():
            orders.drive(velocity)

    return take


def _move(orders: Orders) -> Any:
    def take(message: Any) -> None:
        way = messages.path(message)
        if way is not None:
            orders.move(way)

    return take


def _grip(orders: Orders, topics: Topics) -> Any:
    def take(message: Any) -> None:
        grip = messages.from_gripper(topics.gripper, message) if topics.gripper else None
        if grip is not None:
            orders.grip(grip)

    return take
