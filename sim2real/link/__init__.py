"""The seam to a robot's bus: what goes over it, and what each end of a transport has to do.

A transport is one file that carries these few things; everything else, from frames to the ages of
measurements, lies in `kinfeas.sim2real.link.backend` and is the same for all of them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from kinfeas.core.backend import Grip
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot


@dataclass(frozen=True)
class BaseReading:
    """Where the base was measured to be.

    Attributes:
        x: Along the world's x, metres.
        y: Along the world's y, metres.
        yaw: Heading in radians.
        velocity: x, y and turning in the base frame, shape (3,), m/s and rad/s; None if unknown.
        stamp: When it was measured by the robot's clock, in seconds; None if it has no stamp.
        age: How old it was already when it arrived, in seconds.
    """

    x: float
    y: float
    yaw: float
    velocity: Array | None = None
    stamp: float | None = None
    age: float = 0.0


@dataclass(frozen=True)
class JointReading:
    """Where joints were measured to be, under the robot's own names; any part of all joints.

    Attributes:
        positions: Radians or metres by joint.
        velocities: Per second by joint, where they are measured.
        stamp: As in `BaseReading`.
    """

    positions: Mapping[str, float]
    velocities: Mapping[str, float] = field(default_factory=dict)
    stamp: float | None = None


@dataclass(frozen=True)
class JointPath:
    """Joint positions to pass through, one after the other.

    Attributes:
        joints: The robot's names of the j joints.
        times: Seconds from now, ascending, shape (p,).
        positions: Radians or metres, shape (p, j).
    """

    joints: tuple[str, ...]
    times: Array
    positions: Array


@dataclass(frozen=True)
class Readings:
    """Where a transport hands measurements to; both may be called from any thread."""

    base: Callable[[BaseReading], None]
    joints: Callable[[JointReading], None]


@dataclass(frozen=True)
class Orders:
    """Where the robot's end of a transport hands commands to, from any thread.

    Attributes:
        drive: Takes x, y and turning in the base frame, shape (3,), m/s and rad/s.
        move: Takes the way of some joints, which ends whatever they did before.
        grip: Takes what the gripper shall begin to do.
    """

    drive: Callable[[Array], None]
    move: Callable[[JointPath], None]
    grip: Callable[[Grip], None]


class Link(Protocol):
    """Our end of a transport. Nothing but `open` may block, and no call may fail silently.

    Attributes:
        base_source: Where the base's pose comes from, for errors, such as `/odom`.
        joint_source: Where joint positions come from.
    """

    base_source: str
    joint_source: str

    def open(self, readings: Readings) -> None:
        """Connect and begin to hand on what arrives.

        Raises:
            KinfeasError: If there is nothing to connect to.
        """
        ...

    def waits_for(self) -> str | None:
        """Return what does not listen to our commands yet, or None once all of it does."""
        ...

    def check(self) -> None:
        """Do nothing while the link holds.

        Raises:
            Fault: If it is broken, whatever still seems to arrive.
        """
        ...

    def drive(self, velocity: Array) -> None:
        """Command the base: x, y and turning in its own frame, shape (3,), m/s and rad/s."""
        ...

    def move(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send joints, by the robot's names, to positions that they reach after `seconds`."""
        ...

    def grip(self, grip: Grip) -> None:
        """Begin to close or to open the gripper."""
        ...

    def close(self) -> None:
        """Deliver what was sent and let go; it may be called twice."""
        ...


@runtime_checkable
class RobotLink(Protocol):
    """The robot's end of a transport, for whatever plays the robot."""

    def open(self, orders: Orders) -> None:
        """Connect and begin to hand on the commands that arrive.

        Raises:
            KinfeasError: If there is nothing to connect to.
        """
        ...

    def check(self) -> None:
        """Do nothing while the link holds; raise Fault if it is broken."""
        ...

    def report(self, base: BaseReading, joints: JointReading) -> None:
        """Send a measurement."""
        ...

    def close(self) -> None:
        """Let go; it may be called twice."""
        ...


@runtime_checkable
class Hosted(Protocol):
    """A backend class whose transport has an end for the robot, too."""

    @staticmethod
    def robot_link(robot: Robot, topics: str | None = None) -> RobotLink:
        """Return the robot's end.

        Args:
            robot: Who is played.
            topics: Name or path of the file with its names on the bus; those of the robot by
                default.
        """
        ...
