"""Names of a robot on ROS from YAML: topics, frames, controllers and joints."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval

from kinfeas import config
from kinfeas.config.quantities import Positive
from kinfeas.core.backend import Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.link.scans import OCCUPIED
from kinfeas.sim2real.ros.bus import Version


@dataclass(frozen=True)
class BaseTopics:
    """Topics and frames of the base.

    Attributes:
        command: Topic of geometry_msgs/Twist in the base frame.
        stamped: Whether it is of TwistStamped, as for controllers of newer ROS 2.
        measured_by: Source of the base pose.
        odometry: Topic of nav_msgs/Odometry.
        world_frame: World frame for `tf`.
        frame: Base frame: the root of the URDF.
    """

    command: str
    stamped: bool = False
    measured_by: Literal["odometry", "tf"] = "odometry"
    odometry: str = "/odom"
    world_frame: str = "map"
    frame: str = "base_footprint"


@dataclass(frozen=True)
class Controller:
    """A trajectory controller.

    Attributes:
        command: Topic of trajectory_msgs/JointTrajectory.
        joints: Its joints by the robot's names; each message has all of them.
    """

    command: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class JointTopics:
    """Topics of the arm.

    Attributes:
        measured: Topic of sensor_msgs/JointState.
        controllers: Controllers that have each joint of the arm once.
        names: The robot's names of joints, where the URDF has others.
    """

    measured: str
    controllers: tuple[Controller, ...]
    names: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class GripperTopics:
    """Topic of the gripper.

    Attributes:
        command: Topic.
        kind: Message: trajectory_msgs/JointTrajectory or, in ROS 1, PR2's Pr2GripperCommand.
        open: Open position, radians or metres; one number, or one for each joint.
        closed: Closed position, likewise.
        joints: Joints of the trajectory.
        seconds: Duration of a trajectory.
        max_effort: Force of PR2's command, N; below 0 for no limit.
    """

    command: str
    kind: Literal["trajectory", "pr2"]
    open: float | tuple[float, ...]
    closed: float | tuple[float, ...] = 0.0
    joints: tuple[str, ...] = ()
    seconds: Positive = 1.0
    max_effort: float = -1.0

    def __post_init__(self) -> None:
        """Check that a trajectory has joints, and each joint a position."""
        if self.kind == "trajectory" and not self.joints:
            raise ValueError("'joints' must name at least one joint of a trajectory")
        many = len(self.joints) if self.kind == "trajectory" else 1
        for key, position in (("open", self.open), ("closed", self.closed)):
            if isinstance(position, tuple) and len(position) != many:
                raise ValueError(f"{key!r} must hold {many} positions, or be a number")

    def positions(self, grip: Grip) -> tuple[float, ...]:
        """Return the positions of the joints, closed or open; that of PR2's command."""
        position = self.closed if grip == "close" else self.open
        many = len(self.joints) if self.kind == "trajectory" else 1
        return position if isinstance(position, tuple) else (position,) * many


@dataclass(frozen=True)
class ScanTopic:
    """Topic of a laser.

    Attributes:
        topic: Topic of sensor_msgs/LaserScan.
        x: x of the laser in the base frame, metres; 0 for messages in the base frame.
        y: The same of y.
        yaw: Its heading, radians.
        upside_down: Whether it hangs, so that its angles count clockwise.
    """

    topic: str
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    upside_down: bool = False


@dataclass(frozen=True)
class CostmapTopic:
    """Topic of a costmap.

    Attributes:
        topic: Topic of nav_msgs/OccupancyGrid.
        occupied: Lowest value of an obstacle. Costmaps with an inflation layer need 100.
    """

    topic: str
    occupied: Annotated[int, Interval(ge=1, le=100)] = OCCUPIED


@dataclass(frozen=True)
class Topics:
    """All names of a robot.

    Attributes:
        base: Command and pose of the base.
        joints: Commands and positions of the arm.
        gripper: Command of the gripper, if it has one.
        scan: Laser scanner, if it has one.
        costmap: Costmap, if it has one.
    """

    base: BaseTopics
    joints: JointTopics
    gripper: GripperTopics | None = None
    scan: ScanTopic | None = None
    costmap: CostmapTopic | None = None


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
