"""The names of a robot on ROS: topics, frames, controllers and joints, from YAML."""

from collections import Counter
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Literal

from kinfeas import config
from kinfeas.config.quantities import Positive
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.ros.bus import Version


@dataclass(frozen=True)
class BaseTopics:
    """Of the base.

    Attributes:
        command: Topic of geometry_msgs/Twist in the base frame.
        stamped: Whether it takes TwistStamped instead, as controllers of newer ROS 2 do.
        measured_by: Whether its pose comes from `odometry` or from `tf`.
        odometry: Topic of nav_msgs/Odometry.
        world_frame: Frame in which poses are wanted from tf.
        frame: Frame of the base: the URDF's root.
    """

    command: str
    stamped: bool = False
    measured_by: Literal["odometry", "tf"] = "odometry"
    odometry: str = "/odom"
    world_frame: str = "map"
    frame: str = "base_footprint"


@dataclass(frozen=True)
class Controller:
    """One trajectory controller.

    Attributes:
        command: Topic of trajectory_msgs/JointTrajectory.
        joints: Its joints by the robot's names; it always gets all of them.
    """

    command: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class JointTopics:
    """Of the arm.

    Attributes:
        measured: Topic of sensor_msgs/JointState.
        controllers: They share the arm's joints among them.
        names: The robot's names of joints that are named otherwise in its URDF.
    """

    measured: str
    controllers: tuple[Controller, ...]
    names: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class GripperTopics:
    """Of the gripper.

    Attributes:
        command: Topic to command.
        kind: Whether it takes trajectory_msgs/JointTrajectory or, in ROS 1, PR2's
            Pr2GripperCommand.
        joints: Of the trajectory; every one goes to the same position.
        closed: Position, radians or metres.
        open: The same.
        seconds: That a trajectory takes.
        max_effort: Of PR2's command, N; below 0 for no limit.
    """

    command: str
    kind: Literal["trajectory", "pr2"]
    joints: tuple[str, ...] = ()
    closed: float = 0.0
    open: float = 0.0
    seconds: Positive = 1.0
    max_effort: float = -1.0


@dataclass(frozen=True)
class Topics:
    """All of them; without a gripper, none is commanded."""

    base: BaseTopics
    joints: JointTopics
    gripper: GripperTopics | None = None


def read_topics(
    robot: Robot,
    version: Version,
    name: str | None = None,
    option: str = "--set backend.topics=FILE",
) -> Topics:
    """Return the names of a robot.

    Args:
        robot: Whose arm the controllers must move.
        version: Of ROS.
        name: Path of a YAML file, or the name of one that comes with the package; the robot's
            own name by default.
        option: How the user names a file, for the error.

    Raises:
        KinfeasError: If there is no such file, it is broken, or its controllers do not share the
            arm's joints among them.
    """
    path = _find(robot.name if name is None else name, version, option)
    topics = config.load(Topics, path)
    commanded = Counter(name for one in topics.joints.controllers for name in one.joints)
    arm = Counter(topics.joints.names.get(joint.name, joint.name) for joint in robot.arm)
    if commanded != arm:
        wrong = sorted((commanded - arm) + (arm - commanded))
        raise KinfeasError(
            f"{path}: 'joints.controllers' must hold each joint of the arm once and no other; "
            f"see {', '.join(wrong)}"
        )
    if version != 1 and topics.gripper is not None and topics.gripper.kind == "pr2":
        raise KinfeasError(f"{path}: 'gripper.kind' must be trajectory in ROS {version}")
    return topics


def _find(name: str, version: Version, option: str) -> Path:
    if (own := Path(name)).is_file():
        return own
    folder = Path(str(files("kinfeas.sim2real.ros").joinpath(f"ros{version}_topics")))
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise KinfeasError(
            f"unknown topics {name!r}{no_such(name, known)}, or a YAML file: {option}"
        )
    return folder / f"{name}.yaml"
