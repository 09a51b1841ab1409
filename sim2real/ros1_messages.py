"""ROS 1 messages from what goes over a link, and back."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinfeas.backend import Grip
from kinfeas.sim2real.link import BaseReading, JointPath, JointReading
from kinfeas.sim2real.ros1_names import GripperTopics
from kinfeas.sim2real.ros1_node import ros
from kinfeas.sim2real.ros1_tf import planar
from kinfeas.spatial import Array


def twist(velocity: Array) -> Any:
    """Return a geometry_msgs/Twist of x, y and turning, shape (3,)."""
    message = ros("geometry_msgs.msg").Twist()
    message.linear.x, message.linear.y, message.angular.z = velocity.tolist()
    return message


def trajectory(positions: Mapping[str, float], seconds: float) -> Any:
    """Return a trajectory_msgs/JointTrajectory that ends at rest after `seconds`.

    Its stamp is zero, which means at once.
    """
    msg = ros("trajectory_msgs.msg")
    point = msg.JointTrajectoryPoint()
    point.positions, point.velocities = list(positions.values()), [0.0] * len(positions)
    point.time_from_start = ros("rospy").Duration.from_sec(seconds)
    return msg.JointTrajectory(joint_names=list(positions), points=[point])


def path(message: Any) -> JointPath | None:
    """Return what a JointTrajectory asks for; None if it is broken."""
    joints, points = tuple(message.joint_names), message.points
    if not points or any(len(point.positions) != len(joints) for point in points):
        return None
    times = np.array([point.time_from_start.to_sec() for point in points])
    positions = np.array([point.positions for point in points])
    finite = np.isfinite(times).all() and np.isfinite(positions).all()
    return JointPath(joints, times, positions) if finite and np.all(np.diff(times) > 0.0) else None


def from_odometry(message: Any) -> BaseReading:
    """Return what a nav_msgs/Odometry says."""
    p, q, v = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
    x, y, heading = planar(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))
    velocity = np.array([v.linear.x, v.linear.y, v.angular.z])
    return BaseReading(x, y, heading, velocity, message.header.stamp.to_sec() or None)


def from_joint_state(message: Any) -> JointReading | None:
    """Return what a sensor_msgs/JointState says; None if it says no positions."""
    names = message.name
    if len(message.position) != len(names):
        return None
    has_velocity = len(message.velocity) == len(names)
    velocities = dict(zip(names, message.velocity, strict=True)) if has_velocity else {}
    positions = dict(zip(names, message.position, strict=True))
    return JointReading(positions, velocities, message.header.stamp.to_sec() or None)


def gripper_type(gripper: GripperTopics) -> Any:
    """Return the class of messages that command a gripper."""
    if gripper.kind == "trajectory":
        return ros("trajectory_msgs.msg").JointTrajectory
    # Debian has no package of PR2's messages; this one is made of two numbers.
    name = "pr2_controllers_msgs/Pr2GripperCommand"
    text = "float64 position\nfloat64 max_effort\n"
    return ros("genpy.dynamic").generate_dynamic(name, text)[name]


def gripper_command(gripper: GripperTopics, grip: Grip) -> Any:
    """Return the message that closes or opens a gripper."""
    position = gripper.closed if grip == "close" else gripper.open
    if gripper.kind == "trajectory":
        return trajectory(dict.fromkeys(gripper.joints, position), gripper.seconds)
    return gripper_type(gripper)(position=position, max_effort=gripper.max_effort)


def from_gripper(gripper: GripperTopics, message: Any) -> Grip | None:
    """Return whether a gripper's message rather closes or opens it; None if it is broken."""
    if gripper.kind == "trajectory":
        way = path(message)
        if way is None or not way.joints:
            return None
        position = float(way.positions[-1, 0])
    else:
        position = message.position
    nearer = abs(position - gripper.closed) <= abs(position - gripper.open)
    return "close" if nearer else "open"
