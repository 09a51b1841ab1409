"""The backends `ros1` and `ros2`: a robot, or what plays one, behind the topics of ROS."""

from typing import ClassVar

from kinfeas.robots.robot import Robot
from kinfeas.sim2real.deploy.watchdog import StopCall
from kinfeas.sim2real.link import RobotLink
from kinfeas.sim2real.link.backend import LinkBackend
from kinfeas.sim2real.link.stamps import DRIFT
from kinfeas.sim2real.ros.bus import Version, make_bus
from kinfeas.sim2real.ros.link import RosLink
from kinfeas.sim2real.ros.names import read_topics


class RosBackend(LinkBackend):
    """One robot behind the topics of ROS, of the version that the class of it names.

    Attributes:
        version: Of ROS.
        topics: The names of the robot.
    """

    version: ClassVar[Version]

    def __init__(
        self,
        robot: Robot,
        topics: str | None = None,
        *,
        seconds: float = 0.1,
        patience: float = 5.0,
        stale: float = 0.2,
        drift: float = DRIFT,
    ) -> None:
        """Connect nothing yet: `reset` does.

        Args:
            robot: Robot at the other end.
            topics: Path of a YAML file with its names, or the name of one that comes with the
                package; the robot's own name by default.
            seconds: Seconds in which the arm shall reach each target: time_from_start of its
                points.
            patience: For how many seconds `reset` waits for the first measurements.
            stale: Seconds after which a command is too late, as in `LinkBackend`.
            drift: Share by which the robot's clock may be slower than ours, as in `LinkBackend`;
                0.9 for a simulator that keeps to a tenth of real time.

        Raises:
            KinfeasError: If the file is broken, a duration is not above 0 and finite, or the drift
                not in [0, 1).
        """
        self.topics = read_topics(robot, self.version, topics)
        names = self.topics.joints.names
        link = RosLink(self.topics, make_bus(self.version), drift)
        super().__init__(
            robot,
            link,
            names=names,
            seconds=seconds,
            patience=patience,
            stale=stale,
            drift=drift,
        )

    def stop_call(self) -> StopCall:
        """Return what the watchdog calls."""
        base = self.topics.base
        given = {"version": self.version, "topic": base.command, "stamped": base.stamped}
        return StopCall("kinfeas.sim2real.ros.stop:stop_base", given)

    @classmethod
    def robot_link(cls, robot: Robot, topics: str | None = None) -> RobotLink:
        """Return the robot's end, for what plays a robot; arguments as in `Hosted`."""
        from kinfeas.sim2real.ros.robot import RosRobotLink

        names = read_topics(robot, cls.version, topics, "--topics FILE")
        return RosRobotLink(names, make_bus(cls.version))


class Ros1Backend(RosBackend):
    """One robot behind the topics of ROS 1."""

    version = 1


class Ros2Backend(RosBackend):
    """One robot behind the topics of ROS 2, without ROS on this machine."""

    version = 2
