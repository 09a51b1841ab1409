"""Names of a robot on ROS from YAML: topics, frames, controllers and joints."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas import config
from kinfeas.core.backend import Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Positive
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.link.scans import OCCUPIED
from kinfeas.sim2real.ros.bus import Version


@dataclass(frozen=True)
class BaseTopics:
    """Topics and frames of the base."""

    command: str  # topic of geometry_msgs/Twist in the base frame
    stamped: bool = False  # whether it is of TwistStamped, as for controllers of newer ROS 2
    measured_by: Literal["odometry", "tf"] = "odometry"  # source of the base pose
    odometry: str = "/odom"  # topic of nav_msgs/Odometry
    world_frame: str = "map"  # world frame for `tf`
    frame: str = "base_footprint"  # base frame: the root of the URDF


@dataclass(frozen=True)
class Controller:
    """A trajectory controller."""

    command: str  # topic of trajectory_msgs/JointTrajectory
    joints: tuple[str, ...]  # its joints by the robot's names; each message has all of them


@dataclass(frozen=True)
class JointTopics:
    """Topics of the arm."""

    measured: str  # topic of sensor_msgs/JointState
    controllers: tuple[Controller, ...]  # controllers that have each joint of the arm once
    # the robot's names of joints, where the URDF has others
    names: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class GripperTopics:
    """Topic of the gripper."""

    command: str  # topic
    # message: trajectory_msgs/JointTrajectory or, in ROS 1, PR2's Pr2GripperCommand
    kind: Literal["trajectory", "pr2"]
    # open position, radians or metres; one number, or one for each joint
    open: float | tuple[float, ...]
    closed: float | tuple[float, ...] = 0.0  # closed position, likewise
    joints: tuple[str, ...] = ()  # joints of the trajectory
    seconds: Positive = 1.0  # duration of a trajectory
    max_effort: float = -1.0  # force of PR2's command, N; below 0 for no limit

    def __post_init__(self) -> None:
        """Check that a trajectory has joints, and each joint a position."""
        if self.kind == "trajectory" and not self.joints:
            raise ValueError("'joints' must name at least one joint of a trajectory")
        many = len(self.joints) if self.kind == "trajectory" else 1
        for key, position in (("open", self.open), ("closed", self.closed)):
            if isinstance(position, tuple) and len(position) != many:
                raise ValueError(f"{key!r} must hold {many} positions, or be a number")

    def positions(self, grip: Grip) -> tuple[float, ...]:
        """Return the closed or open positions of the joints, or the one of PR2's command."""
        position = self.closed if grip == "close" else self.open
        many = len(self.joints) if self.kind == "trajectory" else 1
        return position if isinstance(position, tuple) else (position,) * many


@dataclass(frozen=True)
class ScanTopic:
    """Topic of a laser."""

    topic: str  # topic of sensor_msgs/LaserScan
    x: float = 0.0  # its x in the base frame, metres; 0 for messages in the base frame
    y: float = 0.0  # the same of y
    yaw: float = 0.0  # its heading, radians
    upside_down: bool = False  # whether it hangs, so that its angles count clockwise


@dataclass(frozen=True)
class CostmapTopic:
    """Topic of a costmap."""

    topic: str  # topic of nav_msgs/OccupancyGrid
    # lowest value of an obstacle; costmaps with an inflation layer need 100
    occupied: Annotated[int, Interval(ge=1, le=100)] = OCCUPIED


@dataclass(frozen=True)
class Topics:
    """All names of a robot."""

    base: BaseTopics  # command and pose of the base
    joints: JointTopics  # commands and positions of the arm
    gripper: GripperTopics | None = None  # command of the gripper, if it has one
    scan: ScanTopic | None = None  # laser scanner, if it has one
    costmap: CostmapTopic | None = None  # costmap, if it has one


def read_topics(robot: Robot, version: Version, file: str | None = None) -> Topics:
    """Return the topics in a file, by default `ros1.yaml` or `ros2.yaml` in the robot's folder.

    Raises:
        KinfeasError: If the file is missing or invalid, or its controllers do not have each joint
            of the arm once.
    """
    path = robot.folder / f"ros{version}.yaml" if file is None else Path(file)
    if file is None and not path.is_file():
        raise KinfeasError(f"{path} does not exist; 'backend.topics' or --topics names another")
    topics = config.load(Topics, path)
    controllers = topics.joints.controllers
    commanded = Counter(name for controller in controllers for name in controller.joints)
    arm = Counter(topics.joints.names.get(joint.name, joint.name) for joint in robot.arm)
    if commanded != arm:
        wrong = sorted((commanded - arm) + (arm - commanded))
        raise KinfeasError(
            f"{path}: 'joints.controllers' needs each arm joint once; see {', '.join(wrong)}"
        )
    if version != 1 and topics.gripper is not None and topics.gripper.kind == "pr2":
        raise KinfeasError(f"{path}: 'gripper.kind' must be trajectory in ROS {version}")
    return topics
