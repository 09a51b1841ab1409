"""Targets from ROS topics, with the message types of MoveIt Servo."""

from functools import partial
from typing import Any, ClassVar

from kinfeas.sim2real.ros.bus import Version, make_bus
from kinfeas.sim2real.servo.controller import TargetController


class RosSource:
    """Subscribes to geometry_msgs/TwistStamped and PoseStamped.

    Frames are named in the headers; a stamp of zero stands for the arrival.

    Attributes:
        version: Version of ROS.
    """

    version: ClassVar[Version]

    def __init__(
        self,
        twist: str = "/servo_node/delta_twist_cmds",
        pose: str = "/servo_node/pose_target_cmds",
    ) -> None:
        """Use topics with the names that MoveIt Servo has by default."""
        self._topics, self._bus = (twist, pose), make_bus(self.version)

    def start(self, controller: TargetController) -> None:
        """Subscribe; raise KinfeasError if there is no ROS to connect to."""
        self._bus.open("kinfeas_servo")
        messages, (twist, pose) = self._bus.messages, self._topics
        self._bus.subscribe(twist, messages.TwistStamped, partial(_take_twist, controller))
        self._bus.subscribe(pose, messages.PoseStamped, partial(_take_pose, controller))

    def close(self) -> None:
        """Release the topics."""
        self._bus.close()


class Ros1Source(RosSource):
    """Topics of ROS 1."""

    version = 1


class Ros2Source(RosSource):
    """Topics of ROS 2."""

    version = 2


def _take_twist(controller: TargetController, message: Any) -> None:
    header, linear, angular = message.header, message.twist.linear, message.twist.angular
    twist = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    controller.set_twist(twist, header.stamp.to_sec() or None, header.frame_id)


def _take_pose(controller: TargetController, message: Any) -> None:
    header, p, q = message.header, message.pose.position, message.pose.orientation
    pose = [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
    controller.set_target(pose, header.stamp.to_sec() or None, header.frame_id)
