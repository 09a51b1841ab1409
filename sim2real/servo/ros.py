"""Targets from ROS topics, with the message types of MoveIt Servo."""

import time
from functools import partial
from typing import Any, ClassVar

from kinfeas.core.quantities import Seconds
from kinfeas.sim2real.ros.bus import Version, make_bus
from kinfeas.sim2real.ros.messages import pose_of
from kinfeas.sim2real.servo.controller import TargetController


class RosSource:
    """Subscribes to geometry_msgs/TwistStamped and PoseStamped, and nav_msgs/Path for chunks.

    Frames are named in the headers; a stamp of zero stands for the arrival. A path has the time of
    the policy's observation in its header, and the times of its poses in theirs, by a clock that
    agrees with that of this computer. A path in the EE frame is relative to the pose that was
    desired at the observation.
    """

    version: ClassVar[Version]

    def __init__(
        self,
        twist: str = "/servo_node/delta_twist_cmds",
        pose: str = "/servo_node/pose_target_cmds",
        chunk: str = "/servo_node/pose_chunk_cmds",
        keep: Seconds = 0.0,
    ) -> None:
        """Use topics with the names that MoveIt Servo has by default.

        The last chunk stays for `keep` seconds from the observation of a new one.
        """
        self._topics, self._keep, self._bus = (twist, pose, chunk), keep, make_bus(self.version)

    def start(self, controller: TargetController) -> None:
        """Subscribe; raise KinfeasError if there is no ROS to connect to."""
        self._bus.open("kinfeas_servo")
        messages, (twist, pose, chunk) = self._bus.messages, self._topics
        self._bus.subscribe(twist, messages.TwistStamped, partial(_take_twist, controller))
        self._bus.subscribe(pose, messages.PoseStamped, partial(_take_pose, controller))
        self._bus.subscribe(chunk, messages.Path, partial(_take_path, controller, self._keep))

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
    header, pose = message.header, message.pose
    target = pose_of(pose.position, pose.orientation)
    controller.set_target(target, header.stamp.to_sec() or None, header.frame_id)


def _take_path(controller: TargetController, keep: float, message: Any) -> None:
    poses, offset = message.poses, time.monotonic() - time.time()
    controller.set_chunk(
        [pose_of(stamped.pose.position, stamped.pose.orientation) for stamped in poses],
        [stamped.header.stamp.to_sec() + offset for stamped in poses],
        frame=message.header.frame_id,
        observed=message.header.stamp.to_sec() + offset,
        keep=keep,
    )
