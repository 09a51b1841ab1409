"""What a run is made of, and what it comes to."""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from signal import SIGHUP, SIGINT, SIGQUIT, SIGTERM
from typing import Protocol, runtime_checkable

from kinfeas.config import PluginSpec
from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.backend import Backend, RealTimeBackend
from kinfeas.core.policy import CommandFilter, Policy
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolver
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.guards import Clocks
from kinfeas.sim2real.deploy.rate import Timing
from kinfeas.tasks.task import Task


class Code(IntEnum):
    """How a run ended, as the exit code of the command says it; 2 is one that could not begin.

    From 128 on it is the signal that ended it, as a shell says it.
    """

    REACHED = 0
    FAULT = 3
    TIME_OVER = 4
    HUNG_UP = 128 + SIGHUP
    INTERRUPTED = 128 + SIGINT
    QUIT = 128 + SIGQUIT
    TERMINATED = 128 + SIGTERM


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    Attributes:
        code: How it ended.
        reason: The same in one line.
        unstopped: Why the base could not be commanded to zero, or nothing.
        seconds: How long it lasted.
        failures: Control periods without an IK solution.
        timing: How regular they were.
        unclosed: Why the backend could not be closed, or nothing.
        task_done: Whether the objects ended as the task wants them; None if that is not known.
    """

    code: Code
    reason: str
    unstopped: str
    seconds: float
    failures: int
    timing: Timing
    unclosed: str = ""
    task_done: bool | None = None


@runtime_checkable
class TaskWithObjects(Task, Protocol):
    """A task that moves objects of a simulated world."""

    def drawn(self) -> tuple[str, dict[str, Array]]:
        """Return the scene and the world poses of the objects that the last episode moved."""
        ...

    def settle(self, joint_positions: Array, dt: float) -> None:
        """Let the robot stand still while what was put down comes to rest."""
        ...

    def done(self) -> bool | None:
        """Return whether the objects are now as the task wants them; None if it wants nothing."""
        ...


@dataclass(frozen=True)
class Setup:
    """What a run is made of.

    Attributes:
        solver: Places the arm; it also says which robot this is.
        policy: Drives the base.
        task: What is to be done.
        backend: What moves the robot.
        dt: Control period in seconds.
        adapters: What goes around the backend, the first one innermost.
        seconds: How long the run may last.
        seed: Of all that is drawn.
        execution: How EE motions are carried out, before adapters change it.
        filters: Change the policy's commands, in this order.
        guards: When the run is stopped; in a world that keeps to no clock without those that ask
            one.
        real_time: Whether a simulated world keeps to the clock on the wall.
        clocks: What tells the time.
    """

    solver: IkSolver
    policy: Policy
    task: Task
    backend: Backend
    dt: float
    adapters: tuple[PluginSpec, ...] = ()
    seconds: float = math.inf
    seed: int = 0
    execution: ExecutionConfig = field(default_factory=ExecutionConfig)
    filters: tuple[CommandFilter, ...] = ()
    guards: Guards = field(default_factory=Guards)
    real_time: bool = True
    clocks: Clocks = field(default_factory=Clocks)

    def __post_init__(self) -> None:
        """Leave out the guards that do not apply, and check the rest.

        Raises:
            KinfeasError: If control periods of `dt` would set one of them off.
        """
        if not (self.real_time or self.live):
            object.__setattr__(self, "guards", self.guards.timeless())
        self.guards.check_rate(self.dt)

    @property
    def live(self) -> RealTimeBackend | None:
        """The backend, if its robot moves by a clock of its own."""
        return self.backend if isinstance(self.backend, RealTimeBackend) else None
