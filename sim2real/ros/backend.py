"""The backends `ros1` and `ros2`: both ends of the topics of a robot on ROS."""

import logging
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import SCAN_RANGE, Grip, RobotState, StopCall
from kinfeas.core.errors import Fault
from kinfeas.core.quantities import PositiveSeconds
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.link import (
    BaseReading,
    JointPath,
    JointReading,
    Orders,
    Readings,
    RobotLink,
)
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.measurements import DRIFT, Drift
from kinfeas.sim2real.link.scans import CostmapReading, LaserReading, costmap_of
from kinfeas.sim2real.ros import messages as ros_messages
from kinfeas.sim2real.ros.bus import Publisher, RosBus, Version, make_bus
from kinfeas.sim2real.ros.topics import Topics, read_topics

_ODOM = "odom"
_log = logging.getLogger(__name__)
_CELL = 0.05  # m, of costmaps of simulated robots

FramePose = Callable[[str], Array | None]
"""Returns the world pose of a frame, shape (7,), or None if it is not known."""


class RosBackend(LinkBackend):
    """A robot behind the topics of ROS."""

    version: ClassVar[Version]

    def __init__(
        self,
        robot: Robot,
        topics: str | None = None,
        *,
        seconds: PositiveSeconds = 0.1,
        timeout: PositiveSeconds = 5.0,
        drift: Drift = DRIFT,
    ) -> None:
        """Prepare a backend; the first `reset` connects.

        Args:
            robot: Robot model.
            topics: YAML file with the names; by default that in the robot's folder.
            seconds: Minimum time_from_start of an arm target, seconds.
            timeout: Seconds that `reset` waits for the first measurements.
            drift: Fraction by which the robot's clock may be slower than ours: 0.9 for a simulator
                at a tenth of real time.
        """
        self.topics = read_topics(robot, self.version, topics)
        link = RosLink(self.topics, make_bus(self.version), drift)
        names = self.topics.joints.names
        super().__init__(robot, link, names=names, seconds=seconds, timeout=timeout, drift=drift)
        self._shared = link.shared

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Connect, as `LinkBackend` does, and warn of other publishers of exclusive topics."""
        opened = self._opened  # after the first reset, the watchdog publishes, too
        state = super().reset(base_pose, joint_positions, env_ids)
        if not opened and (shared := self._shared()):
            topics = ", ".join(shared)
            _log.warning("other nodes publish on %s, too: their messages mix with ours", topics)
        return state

    def stop_call(self) -> StopCall:
        """Return the call with which the watchdog stops the base."""
        base = self.topics.base
        arguments = {"version": self.version, "topic": base.command, "stamped": base.stamped}
        return StopCall("kinfeas.sim2real.ros.bus:stop_base", arguments)

    @classmethod
    def robot_link(cls, robot: Robot, topics: str | None = None) -> RobotLink:
        """Return the robot's end, for a simulated robot; arguments as in `RobotLink`."""
        return RosRobotLink(read_topics(robot, cls.version, topics), make_bus(cls.version))


class Ros1Backend(RosBackend):
    """A robot behind the topics of ROS 1."""

    version = 1


class Ros2Backend(RosBackend):
    """A robot with ROS 2 topics; no ROS installation is needed."""

    version = 2

    def _missing(self) -> str:
        domain = os.environ.get("ROS_DOMAIN_ID") or 0
        return (reason := super()._missing()) and f"{reason} (ROS_DOMAIN_ID is {domain})"


class RosLink:
    """The deployment's end: commands base, arm and gripper, reads joints and odometry or TF."""

    def __init__(self, topics: Topics, bus: RosBus, drift: float = DRIFT) -> None:
        base = topics.base
        tf = f"/tf ({base.world_frame} to {base.frame})"
        self.base_source = base.odometry if base.measured_by == "odometry" else tf
        self.joint_source = topics.joints.measured
        sources = ((LaserReading, topics.scan), (CostmapReading, topics.costmap))
        self.scan_sources = {kind: source.topic for kind, source in sources if source is not None}
        self._topics, self._bus, self._drift = topics, bus, drift
        self._types: dict[str, Any] = {}
        self._publishers: dict[str, Publisher] = {}
        self._frame_fault: str | None = None

    def open(self, readings: Readings) -> None:
        """Connect; raise KinfeasError if there is no ROS to connect to."""
        self._bus.open("kinfeas")
        self._frame_fault = None
        topics, messages = self._topics, self._bus.messages
        self._types = ros_messages.command_types(messages, topics)
        self._publishers = {
            topic: self._bus.publisher(topic, kind) for topic, kind in self._types.items()
        }
        take_joints = _passing(ros_messages.from_joint_state, readings.joints)
        self._bus.subscribe(self.joint_source, messages.JointState, take_joints)
        if topics.base.measured_by == "odometry":
            pose_of = self._listen_to_odometry(readings)
        else:
            pose_of = self._listen_to_tf(readings)
        self._listen_to_scans(readings, pose_of)

    def waits_for(self) -> str | None:
        """Return the first topic without a subscriber, except the gripper's."""
        base, joints = self._topics.base, self._topics.joints
        topics = [base.command, *(controller.command for controller in joints.controllers)]
        return next((topic for topic in topics if not self._publishers[topic].listeners()), None)

    def shared(self) -> list[str]:
        """Return the command topics that other nodes publish, too, and a shared odometry topic."""
        shared = [topic for topic, kind in self._types.items() if self._bus.senders(topic, kind)]
        odometry, kind = self._topics.base.odometry, self._bus.messages.Odometry
        if self.base_source == odometry and self._bus.senders(odometry, kind) > 1:
            shared.append(odometry)
        return shared

    def check(self) -> None:
        """Raise Fault if the connection is broken or the odometry is of another frame."""
        self._bus.check()
        if self._frame_fault is not None:
            raise Fault(self._frame_fault)

    def drive(self, velocity: Array) -> None:
        """Send the velocity in the base frame, shape (3,), m/s and rad/s."""
        base = self._topics.base
        stamp = time.time() if base.stamped else None
        message = ros_messages.drive_command(self._bus.messages, velocity, stamp)
        self._publishers[base.command].publish(message)

    def move(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send each controller its joints."""
        for controller in self._topics.joints.controllers:
            targets = {name: positions[name] for name in controller.joints}
            message = ros_messages.trajectory(self._bus.messages, targets, seconds)
            self._publishers[controller.command].publish(message)

    def grip(self, grip: Grip) -> None:
        """Close or open the gripper, if the file names one."""
        gripper = self._topics.gripper
        if gripper is not None:
            message = ros_messages.gripper_command(self._bus.messages, gripper, grip)
            self._publishers[gripper.command].publish(message)

    def close(self) -> None:
        """Deliver what was sent and release the topics; it may be called twice."""
        self._bus.close()

    def _listen_to_scans(self, readings: Readings, pose_of: FramePose) -> None:
        topics, messages = self._topics, self._bus.messages
        if topics.scan is not None:
            laser = partial(ros_messages.from_laser_scan, topics.scan, topics.base.frame)
            take = _passing(laser, readings.scan)
            self._bus.subscribe(topics.scan.topic, messages.LaserScan, take)
        if (grid := topics.costmap) is not None:

            def read(message: Any) -> CostmapReading | None:
                frame = pose_of(message.header.frame_id)
                return None if frame is None else ros_messages.from_costmap(grid, frame, message)

            take = _passing(read, readings.scan)
            self._bus.subscribe(grid.topic, messages.OccupancyGrid, take)

    def _listen_to_odometry(self, readings: Readings) -> FramePose:
        frame, world = self._topics.base.frame.lstrip("/"), ""

        def take(message: Any) -> None:
            nonlocal world
            world = message.header.frame_id.lstrip("/")
            child = message.child_frame_id.lstrip("/")
            if child not in ("", frame):
                self._frame_fault = (
                    f"{self.base_source} measures frame {child}, but the base frame is {frame}"
                )
            readings.base(ros_messages.from_odometry(message))

        def pose_of(map_frame: str) -> Array | None:
            if world and map_frame.lstrip("/") not in ("", world):
                self._frame_fault = (
                    f"the costmap is in frame {map_frame}, but {self.base_source} in {world}"
                )
            return IDENTITY if world else None

        self._bus.subscribe(self.base_source, self._bus.messages.Odometry, take)
        return pose_of

    def _listen_to_tf(self, readings: Readings) -> FramePose:
        base = self._topics.base
        tree = ros_messages.TfTree(base.world_frame, base.frame, self._drift)
        kind = self._bus.messages.TFMessage

        def read(message: Any) -> BaseReading | None:
            tree.take(message)
            return tree.reading()

        # Each message may have other transforms, so that none may be skipped.
        self._bus.subscribe("/tf", kind, _passing(read, readings.base), every=True)
        self._bus.subscribe("/tf_static", kind, partial(tree.take, static=True), every=True)
        return tree.pose


class RosRobotLink:
    """The robot's end: reads commands, publishes odometry, joint states, TF and scans."""

    def __init__(self, topics: Topics, bus: RosBus) -> None:
        self._topics, self._bus = topics, bus
        self._urdf_names = {name: urdf for urdf, name in topics.joints.names.items()}

    def open(self, orders: Orders) -> None:
        """Connect; raise KinfeasError if there is no ROS to connect to."""
        bus, topics = self._bus, self._topics
        bus.open("kinfeas_robot")
        messages = bus.messages
        types, base = ros_messages.command_types(messages, topics), topics.base.command
        drop = orders.drop
        bus.subscribe(base, types[base], _passing(_finite_velocity, orders.drive, drop))
        move = _passing(self._path, orders.move, drop)
        for controller in topics.joints.controllers:
            bus.subscribe(controller.command, types[controller.command], move)
        if (gripper := topics.gripper) is not None:
            grip = _passing(partial(ros_messages.from_gripper, gripper), orders.grip, drop)
            bus.subscribe(gripper.command, types[gripper.command], grip)
        self._odometry = bus.publisher(topics.base.odometry, messages.Odometry)
        self._joints = bus.publisher(topics.joints.measured, messages.JointState)
        self._tf = bus.publisher("/tf", messages.TFMessage)
        if topics.scan is not None:
            self._scan = bus.publisher(topics.scan.topic, messages.LaserScan)
        if topics.costmap is not None:
            self._costmap = bus.publisher(topics.costmap.topic, messages.OccupancyGrid)

    def _path(self, message: Any) -> JointPath | None:
        """Return a trajectory with the names of the URDF."""
        path = ros_messages.path(message)
        if path is None:
            return None
        return replace(path, joints=tuple(self._urdf_names.get(n, n) for n in path.joints))

    def check(self) -> None:
        """Raise Fault if the connection is broken."""
        self._bus.check()

    def report(self, base: BaseReading, joints: JointReading, ranges: Array | None) -> None:
        """Publish a measurement; the low band as a laser, the high one as a costmap."""
        now = time.time() if base.stamp is None else base.stamp
        stamp = self._bus.messages.Time.from_sec(now)
        self._odometry.publish(self._odometry_of(base, stamp))
        self._joints.publish(self._joint_state(joints, stamp))
        world, frame = self._topics.base.world_frame, self._topics.base.frame
        message, identity = self._bus.messages.TFMessage(), BaseReading(0.0, 0.0, 0.0)
        message.transforms = [
            self._transform(world, _ODOM, identity, stamp),
            self._transform(_ODOM, frame, base, stamp),
        ]
        self._tf.publish(message)
        if ranges is not None:
            self._report_scan(base, ranges, stamp)

    def _report_scan(self, base: BaseReading, ranges: Array, stamp: Any) -> None:
        messages, topics = self._bus.messages, self._topics
        if topics.scan is not None:
            scan = ros_messages.laser_scan(messages, ranges[0])
            scan.header.stamp, scan.header.frame_id = stamp, topics.base.frame
            self._scan.publish(scan)
        if topics.costmap is not None:
            costmap = costmap_of(ranges[1], (base.x, base.y, base.yaw), 2.0 * SCAN_RANGE, _CELL)
            grid = ros_messages.occupancy_grid(messages, costmap)
            grid.header.stamp, grid.header.frame_id = stamp, _ODOM
            self._costmap.publish(grid)

    def close(self) -> None:
        """Release the topics; it may be called twice."""
        self._bus.close()

    def _odometry_of(self, base: BaseReading, stamp: Any) -> Any:
        message = self._bus.messages.Odometry()
        message.header.stamp, message.header.frame_id = stamp, _ODOM
        message.child_frame_id = self._topics.base.frame
        pose = message.pose.pose
        _fill_pose(pose.position, pose.orientation, base)
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
        _fill_pose(message.transform.translation, message.transform.rotation, base)
        return message


def _fill_pose(position: Any, quaternion: Any, base: BaseReading) -> None:
    position.x, position.y = base.x, base.y
    quaternion.z, quaternion.w = math.sin(base.yaw / 2.0), math.cos(base.yaw / 2.0)


def _finite_velocity(message: Any) -> Array | None:
    velocity = ros_messages.velocity(message)
    return velocity if np.isfinite(velocity).all() else None


def _passing(
    read: Callable[[Any], Any], take: Callable[[Any], None], drop: Callable[[], None] = lambda: None
) -> Callable[[Any], None]:
    """Return a callback that passes on what `read` makes of a message, or calls `drop` for None."""

    def passing(message: Any) -> None:
        value = read(message)
        if value is None:
            drop()
        else:
            take(value)

    return passing
