"""A simulated robot on the bus of a real one, in real time."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.deploy.rate import Rate
from kinfeas.sim2real.link import Hosted, RobotLink
from kinfeas.sim2real.link.fault import Fault
from kinfeas.sim2real.simulator.simulated_robot import Role, SimulatedRobot

_CATCH_UP = 10  # ticks of physics in one period at most, when the machine is late
_LINGER = 2.0  # s for which a robot goes on whose bus has broken


@dataclass(frozen=True)
class Played:
    """What came of it.

    Attributes:
        seconds: How long it lasted.
        base_commands: How many commands the base got.
        joint_commands: How many ways the arm's controllers got.
        timeouts: How often the base stopped by itself while it was commanded to move.
        period_p99: Length of a tick that one in a hundred exceeds, seconds.
        longest: The longest tick, seconds.
    """

    seconds: float
    base_commands: int
    joint_commands: int
    timeouts: int
    period_p99: float
    longest: float


def robot_link(backend: str, robot: Robot, topics: str | None = None) -> RobotLink:
    """Return the robot's end of the bus of a backend.

    Args:
        backend: Entry-point name in the group kinfeas.backends.
        robot: Who is played.
        topics: Name or path of the file with its names on the bus; its own by default.

    Raises:
        KinfeasError: If the backend is unknown, on no bus or broken, or the names do not fit.
    """
    kind = registry.load("kinfeas.backends", backend)
    if not isinstance(kind, Hosted):
        raise KinfeasError(f"backend {backend!r} is on no bus that a robot can be played on")
    with plugin_note(f"backend {backend!r}"):
        link = kind.robot_link(robot, topics)
    if not isinstance(link, RobotLink):
        must = "must return a RobotLink from robot_link"
        raise KinfeasError(f"backend {backend!r} {must}, not {type(link).__name__}")
    return link


def play(
    player: SimulatedRobot, link: RobotLink, role: Role, on_ready: Callable[[], None]
) -> Played:
    """Play a robot on a bus until its time is over, or Ctrl-C, and return what came of it.

    Args:
        player: The robot.
        link: Its end of the bus; it is opened and closed here.
        role: How it is played.
        on_ready: Called once it listens.

    Raises:
        KinfeasError: If there is no bus, or it has broken. The robot goes on for a while then: who
            is connected to it still is. Also if a link from outside fails, at once.
    """
    name = f"robot link {type(link).__name__}"
    with plugin_note(name):
        link.open(player.orders())
    rate, begin, broken = Rate(1.0 / role.rate), time.monotonic(), None
    end = math.inf if role.seconds is None else begin + role.seconds
    try:
        on_ready()
        while time.monotonic() < end:
            readings = player.measure()
            with plugin_note(name):
                link.report(*readings)
            ticks = round(rate.wait() * role.rate)
            for _ in range(min(max(ticks, 1), _CATCH_UP)):
                player.tick(1.0 / role.rate)
            if broken is None and (broken := _fault(link)) is not None:
                end = time.monotonic() + _LINGER
    except KeyboardInterrupt:
        pass  # as a robot is switched off that has no end of its own
    finally:
        with plugin_note(name):
            link.close()
    if broken is not None:
        raise KinfeasError(str(broken))
    timing = rate.timing()
    seconds = time.monotonic() - begin
    counts = player.base_commands, player.joint_commands, player.timeouts
    return Played(seconds, *counts, timing.p99, timing.longest)


def _fault(link: RobotLink) -> Fault | None:
    try:
        with plugin_note(f"robot link {type(link).__name__}"):
            link.check()
    except Fault as fault:
        return fault
    return None
