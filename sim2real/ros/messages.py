"""Conversion of messages of ROS 1 and 2 to and from the readings and commands of a link."""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from kinfeas.core.backend import SCAN_RANGE, Grip
from kinfeas.core.quantities import FARTHEST
from kinfeas.core.spatial import IDENTITY, UNIT, Array, compose, relative
from kinfeas.sim2real.link import BaseReading, JointPath, JointReading
from kinfeas.sim2real.link.measurements import DRIFT, TransportDelay
from kinfeas.sim2real.link.scans import ANGLES, CostmapReading, LaserReading
from kinfeas.sim2real.ros.topics import CostmapTopic, GripperTopics, ScanTopic, Topics

_FINEST = 1e-3  # m, least edge of the cells of a costmap: finer ones fill the memory
_DEEPEST = 32  # frames from the base to the world; more of them are a cycle


def command_types(messages: Any, topics: Topics) -> dict[str, Any]:
    """Return the message classes of the commands to base, arm and gripper, by topic."""
    base = messages.TwistStamped if topics.base.stamped else messages.Twist
    arm = (controller.command for controller in topics.joints.controllers)
    types = {topics.base.command: base, **dict.fromkeys(arm, messages.JointTrajectory)}
    if (gripper := topics.gripper) is not None:
        pr2 = gripper.kind == "pr2"
        types[gripper.command] = messages.Pr2GripperCommand if pr2 else messages.JointTrajectory
    return types


def fill_twist(message: Any, velocity: Array) -> None:
    """Set a geometry_msgs/Twist to forward, left and rotation, shape (3,)."""
    message.linear.x, message.linear.y, message.angular.z = velocity.tolist()


def drive_command(messages: Any, velocity: Array, stamp: float | None) -> Any:
    """Return a geometry_msgs/Twist, or a TwistStamped for a `stamp` in seconds.

    The velocity is forward, left and rotation, shape (3,), m/s and rad/s.
    """
    message = messages.Twist() if stamp is None else messages.TwistStamped()
    if stamp is not None:
        message.header.stamp = messages.Time.from_sec(stamp)
    fill_twist(message if stamp is None else message.twist, velocity)
    return message


def velocity(message: Any) -> Array:
    """Return forward, left and rotation of a Twist or TwistStamped, shape (3,)."""
    twist = getattr(message, "twist", message)
    return np.array([twist.linear.x, twist.linear.y, twist.angular.z])


def trajectory(messages: Any, positions: Mapping[str, float], seconds: float) -> Any:
    """Return a trajectory_msgs/JointTrajectory that starts now and ends at rest after `seconds`."""
    point = messages.JointTrajectoryPoint()
    point.positions, point.velocities = list(positions.values()), [0.0] * len(positions)
    point.time_from_start = messages.Duration.from_sec(seconds)
    message = messages.JointTrajectory()
    message.joint_names, message.points = list(positions), [point]
    return message


def path(message: Any) -> JointPath | None:
    """Return the path of a JointTrajectory; None if it is invalid."""
    joints, points = tuple(message.joint_names), message.points
    if not points or any(len(point.positions) != len(joints) for point in points):
        return None
    times = np.array([point.time_from_start.to_sec() for point in points])
    positions = np.array([point.positions for point in points])
    sound = np.isfinite(times).all() and (np.abs(positions) <= FARTHEST).all()
    return JointPath(joints, times, positions) if sound and np.all(np.diff(times) > 0.0) else None


def from_odometry(message: Any) -> BaseReading:
    """Return the measurement of a nav_msgs/Odometry."""
    pose, stamp = message.pose.pose, message.header.stamp.to_sec() or None
    return _base_reading(pose_of(pose.position, pose.orientation), velocity(message.twist), stamp)


def from_joint_state(message: Any) -> JointReading | None:
    """Return the measurement of a sensor_msgs/JointState; None without positions."""
    names = message.name
    if len(message.position) != len(names):
        return None
    has_velocity = len(message.velocity) == len(names)
    velocities = dict(zip(names, message.velocity, strict=True)) if has_velocity else {}
    positions = dict(zip(names, message.position, strict=True))
    return JointReading(positions, velocities, message.header.stamp.to_sec() or None)


def from_laser_scan(topic: ScanTopic, base_frame: str, message: Any) -> LaserReading:
    """Return the measurement of a sensor_msgs/LaserScan."""
    in_base = message.header.frame_id.lstrip("/") == base_frame.lstrip("/")
    sign = -1.0 if topic.upside_down and not in_base else 1.0
    mount = (0.0, 0.0, 0.0) if in_base else (topic.x, topic.y, topic.yaw)
    return LaserReading(
        np.array(message.ranges, dtype=float), sign * message.angle_min,
        sign * message.angle_increment, message.range_min, message.range_max, mount,
        message.header.stamp.to_sec() or None,
    )  # fmt: skip


def laser_scan(messages: Any, ranges: Array) -> Any:
    """Return a sensor_msgs/LaserScan of the beams of a scan, shape (b,)."""
    message = messages.LaserScan()
    message.angle_min, message.angle_max = float(ANGLES[0]), float(ANGLES[-1])
    message.angle_increment = float(ANGLES[1] - ANGLES[0])
    message.range_max = SCAN_RANGE
    message.ranges = np.where(ranges < SCAN_RANGE, ranges, np.inf).tolist()
    return message


def from_costmap(topic: CostmapTopic, frame: Array, message: Any) -> CostmapReading | None:
    """Return the measurement of a nav_msgs/OccupancyGrid; None if it is invalid.

    `frame` is the world pose of the frame of its header, shape (7,).
    """
    info = message.info
    origin = planar(compose(frame, pose_of(info.origin.position, info.origin.orientation)))
    cells = np.array(message.data, dtype=np.int8)
    shape, resolution = (info.height, info.width), float(info.resolution)
    valid = np.isfinite([*origin, resolution]).all() and resolution >= _FINEST
    if not valid or not cells.size or cells.size != math.prod(shape):
        return None
    stamp = message.header.stamp.to_sec() or None
    return CostmapReading(cells.reshape(shape), resolution, origin, topic.occupied, stamp)


def occupancy_grid(messages: Any, costmap: CostmapReading) -> Any:
    """Return a nav_msgs/OccupancyGrid of a costmap along the axes of its frame."""
    message = messages.OccupancyGrid()
    info, origin = message.info, message.info.origin
    info.height, info.width = costmap.cells.shape
    info.resolution, origin.orientation.w = costmap.resolution, 1.0
    origin.position.x, origin.position.y = costmap.origin[:2]
    message.data = costmap.cells.ravel().tolist()
    return message


def gripper_command(messages: Any, gripper: GripperTopics, grip: Grip) -> Any:
    """Return the message that closes or opens a gripper."""
    positions = gripper.positions(grip)
    if gripper.kind == "trajectory":
        targets = dict(zip(gripper.joints, positions, strict=True))
        return trajectory(messages, targets, gripper.seconds)
    message = messages.Pr2GripperCommand()
    message.position, message.max_effort = positions[0], gripper.max_effort
    return message


def from_gripper(gripper: GripperTopics, message: Any) -> Grip | None:
    """Return the state nearer to a gripper's commanded position; None if it is invalid."""
    closed, opened = gripper.positions("close"), gripper.positions("open")
    if gripper.kind == "trajectory":
        points = path(message)
        if points is None or not points.joints or points.joints[0] not in gripper.joints:
            return None
        row, position = gripper.joints.index(points.joints[0]), float(points.positions[-1, 0])
    else:
        row, position = 0, message.position
    if not math.isfinite(position):
        return None
    nearer = abs(position - closed[row]) <= abs(position - opened[row])
    return "close" if nearer else "open"


def pose_of(p: Any, q: Any) -> Array:
    """Return the pose of a position and a quaternion, shape (7,)."""
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


def planar(pose: Array) -> tuple[float, float, float]:
    """Return x, y and heading of a pose, shape (7,); NaN without a unit quaternion."""
    x, y, _, qx, qy, qz, qw = pose.tolist()
    if not abs(math.hypot(qx, qy, qz, qw) - 1.0) <= UNIT:
        return math.nan, math.nan, math.nan
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def _base_reading(
    pose: Array, velocity: Array | None, stamp: float | None, age: float = 0.0
) -> BaseReading:
    x, y, heading = planar(pose)
    length = float(np.linalg.norm(pose[3:]))
    fault = f"the quaternion of the measured base pose has length {length:.4g}, not 1"
    return BaseReading(x, y, heading, velocity, stamp, age, fault if math.isnan(x) else "")


class TfTree:
    """The newest transforms of TF: a replacement of tf2 for the pose of one frame in another."""

    def __init__(
        self, world: str, base: str, drift: float = DRIFT, now: Callable[[], float] = time.monotonic
    ) -> None:
        """Start without transforms; `world` and `base` are names of frames."""
        self._world, self._base, self._now = world.lstrip("/"), base.lstrip("/"), now
        self._edges: dict[str, tuple[str, Array, float, float]] = {}  # parent, pose, stamp, sent
        self._delays: defaultdict[str, TransportDelay] = defaultdict(partial(TransportDelay, drift))

    def take(self, message: Any, *, static: bool = False) -> None:
        """Take a tf2_msgs/TFMessage; `static` transforms do not age."""
        now = self._now()
        for transform in message.transforms:
            child = transform.child_frame_id.lstrip("/")
            parent = transform.header.frame_id.lstrip("/")
            pose = pose_of(transform.transform.translation, transform.transform.rotation)
            stamp = transform.header.stamp.to_sec()
            sent = math.inf if static else now
            if stamp and not static:
                sent = self._delays[child].sent(stamp, now)
            self._edges[child] = parent, pose, stamp, sent

    def reading(self) -> BaseReading | None:
        """Return the base pose with the age of its oldest transform; None if one is missing."""
        measured = self._base_in(self._world)
        if measured is None:
            return None
        pose, oldest, stamp = measured
        return _base_reading(pose, None, stamp or None, max(0.0, self._now() - oldest))

    def pose(self, frame: str) -> Array | None:
        """Return the world pose of a frame above the base, (7,); None without its transforms."""
        in_world, in_frame = self._base_in(self._world), self._base_in(frame.lstrip("/"))
        if in_world is None or in_frame is None:
            return None
        return compose(in_world[0], relative(IDENTITY, in_frame[0]))

    def _base_in(self, world: str) -> tuple[Array, float, float | None] | None:
        """Return the base pose in a frame, when its oldest transform was sent, and its stamp."""
        edges, frame = dict(self._edges), self._base
        pose, oldest, stamp = IDENTITY, math.inf, None
        for _ in range(_DEEPEST):
            if frame == world:
                return pose, oldest, stamp
            if frame not in edges:
                return None
            frame, above, when, sent = edges[frame]
            stamp = when if stamp is None else stamp
            pose, oldest = compose(above, pose), min(oldest, sent)
        return None
