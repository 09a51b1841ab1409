"""ROS messages from what goes over a link, and back, for both versions of ROS."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kinfeas.core.backend import Grip
from kinfeas.core.spatial import Array
from kinfeas.sim2real.link import BaseReading, JointPath, JointReading
from kinfeas.sim2real.ros.bus import Messages
from kinfeas.sim2real.ros.names import GripperTopics
from kinfeas.sim2real.ros.tf import planar


def fill_twist(message: Any, velocity: Array) -> None:
    """Set a geometry_msgs/Twist to x, y and turning, shape (3,)."""
    message.linear.x, message.linear.y, message.angular.z = velocity.tolist()


def drive_command(messages: Messages, velocity: Array, stamp: float | None) -> Any:
    """Return a geometry_msgs/Twist, or a TwistStamped.

    Args:
        messages: Classes of messages.
        velocity: x, y and turning in the base frame, shape (3,), m/s and rad/s.
        stamp: Seconds of the system's clock for a TwistStamped, None for a Twist.
    """
    if stamp is None:
        message = messages.Twist()
        fill_twist(message, velocity)
        return message
    stamped = messages.TwistStamped()
    stamped.header.stamp = messages.Time.from_sec(stamp)
    fill_twist(stamped.twist, velocity)
    return stamped


def velocity(message: Any) -> Array:
    """Return what a Twist or a TwistStamped asks for: x, y and turning, shape (3,)."""
    twist = getattr(message, "twist", message)
    return np.array([twist.linear.x, twist.linear.y, twist.angular.z])


def trajectory(messages: Messages, positions: Mapping[str, float], seconds: float) -> Any:
    """Return a trajectory_msgs/JointTrajectory that ends at rest after `seconds`.

    Its stamp is zero, which means at once.
    """
    point = messages.JointTrajectoryPoint()
    point.positions, point.velocities = list(positions.values()), [0.0] * len(positions)
    point.time_from_start = messages.Duration.from_sec(seconds)
    message = messages.JointTrajectory()
    message.joint_names, message.points = list(positions), [point]
    return message


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
    p, q = message.pose.pose.position, message.pose.pose.orientation
    x, y, heading = planar(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))
    moves = velocity(message.twist)
    return BaseReading(x, y, heading, moves, message.header.stamp.to_sec() or None)


def from_joint_state(message: Any) -> JointReading | None:
    """Return what a sensor_msgs/JointState says; None if it says no positions."""
    names = message.name
    if len(message.position) != len(names):
        return None
    has_velocity = len(message.velocity) == len(names)
    velocities = dict(zip(names, message.velocity, strict=True)) if has_velocity else {}
    positions = dict(zip(names, message.position, strict=True))
    return JointReading(positions, velocities, message.header.stamp.to_sec() or None)


def gripper_type(messages: Messages, gripper: GripperTopics) -> Any:
    """Return the class of messages that command a gripper."""
    return messages.Pr2GripperCommand if gripper.kind == "pr2" else messages.JointTrajectory


def gripper_command(messages: Messages, gripper: GripperTopics, grip: Grip) -> Any:
    """Return the message that closes or opens a gripper."""
    position = gripper.closed if grip == "close" else gripper.open
    if gripper.kind == "trajectory":
        return trajectory(messages, dict.fromkeys(gripper.joints, position), gripper.seconds)
    message = messages.Pr2GripperCommand()
    message.position, message.max_effort = position, gripper.max_effort
    return message


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
