"""Interface to the bus of a robot: the messages and the two ends of a transport.

A transport is a class that implements `Link`. `kinfeas.sim2real.link.backend` adds everything that
transports have in common: frames, limits of the arm and ages of measurements.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from kinfeas.core.backend import Grip
from kinfeas.core.spatial import Array
from kinfeas.sim2real.link.scans import CostmapReading, LaserReading


@dataclass(frozen=True)
class BaseReading:
    """A measured base pose."""

    x: float  # world x, metres
    y: float  # world y, metres
    yaw: float  # heading in radians
    # forward, left and rotation in the base frame, shape (3,), m/s and rad/s, or None
    velocity: Array | None = None
    stamp: float | None = None  # time of the measurement by the robot's clock, seconds, or None
    age: float = 0.0  # age on arrival, seconds, as far as the transport measures it
    fault: str = ""  # why it is not finite, as far as the transport can tell


@dataclass(frozen=True)
class JointReading:
    """Measured joints by the robot's joint names; a message may hold some of them only."""

    positions: Mapping[str, float]  # radians or metres
    # rad/s or m/s, of the joints for which they are measured
    velocities: Mapping[str, float] = field(default_factory=dict)
    stamp: float | None = None  # as in `BaseReading`


@dataclass(frozen=True)
class JointPath:
    """A joint trajectory."""

    joints: tuple[str, ...]  # the robot's names of the j joints
    times: Array  # seconds from now, ascending, shape (p,)
    positions: Array  # radians or metres, shape (p, j)


@dataclass(frozen=True)
class Readings:
    """Callbacks for the measurements of a transport, safe to call from any thread."""

    base: Callable[[BaseReading], None]
    joints: Callable[[JointReading], None]
    scan: Callable[[LaserReading | CostmapReading], None] = lambda _: None


@dataclass(frozen=True)
class Orders:
    """Callbacks for the commands that reach a robot, safe to call from any thread."""

    # takes the velocity in the base frame, shape (3,), m/s and rad/s
    drive: Callable[[Array], None]
    # takes a joint trajectory, which replaces the last one of these joints
    move: Callable[[JointPath], None]
    grip: Callable[[Grip], None]  # takes `close` or `open`
    drop: Callable[[], None] = lambda: None  # counts an invalid message, which has no effect


class Link(Protocol):
    """The deployment's end of a transport. Only `open` may block.

    A link with a laser or costmap also has the attribute `scan_sources`: source by type of reading.

    Attributes:
        base_source: Source of the base pose for errors, such as `/odom`.
        joint_source: Source of the joint positions.
    """

    base_source: str
    joint_source: str

    def open(self, readings: Readings) -> None:
        """Connect and pass on what arrives; raise KinfeasError if nothing can be reached."""

    def waits_for(self) -> str | None:
        """Return a command that has no receiver yet, or None if all have one."""

    def check(self) -> None:
        """Raise Fault if the connection is broken."""

    def drive(self, velocity: Array) -> None:
        """Send the velocity in the base frame, shape (3,), m/s and rad/s."""

    def move(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send joints, by the robot's names, to positions that they reach after `seconds`."""

    def grip(self, grip: Grip) -> None:
        """Close or open the gripper."""

    def close(self) -> None:
        """Deliver what was sent and disconnect; it may be called twice."""


class RobotLink(Protocol):
    """The robot's end of a transport, for simulated robots.

    It comes from the method `robot_link(robot, topics)` of the backend's class, where `topics` is
    the path of the file with the names on the bus, or None for the robot's own.
    """

    def open(self, orders: Orders) -> None:
        """Connect and pass on the commands; raise KinfeasError if nothing can be reached."""

    def check(self) -> None:
        """Raise Fault if the connection is broken."""

    def report(self, base: BaseReading, joints: JointReading, ranges: Array | None) -> None:
        """Send a measurement, and the ranges around the base if there are new ones.

        Ranges are those of `SCAN_BANDS`, shape (2, `SCAN_BEAMS`), metres.
        """

    def close(self) -> None:
        """Disconnect; it may be called twice."""
