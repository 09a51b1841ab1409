"""What a run is made of, and what it comes to."""

import math
from dataclasses import dataclass, field
from enum import IntEnum

from kinfeas.backend import Backend
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import Pace
from kinfeas.policy import Policy
from kinfeas.sim2real.guard_config import Guards
from kinfeas.sim2real.guards import Clocks
from kinfeas.sim2real.metronome import Timing
from kinfeas.tasks.task import Task


class Code(IntEnum):
    """How a run ended, as the exit code of the command says it; 2 is one that could not begin."""

    REACHED = 0
    FAULT = 3
    TIME_OVER = 4
    INTERRUPTED = 130
    TERMINATED = 143


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    Attributes:
        code: How it ended.
        reason: The same in one line.
        unstopped: Why the base could not be commanded to zero, or nothing.
        seconds: How long it lasted, by control periods.
        failures: Control periods without an IK solution.
        timing: How regular they were.
    """

    code: Code
    reason: str
    unstopped: str
    seconds: float
    failures: int
    timing: Timing


@dataclass(frozen=True)
class Setup:
    """What a run is made of.

    Attributes:
        solver: Places the arm; it also says which robot this is.
        policy: Drives the base.
        task: What is to be done.
        raw: What moves the robot.
        backend: The same within its adapters.
        dt: Control period in seconds.
        seconds: How long the run may last.
        seed: Of all that is drawn.
        pace: How EE motions are carried out, before adapters change it.
        guards: When the run is stopped.
        real_time: Whether a simulated world keeps to the clock on the wall.
        clocks: What tells the time.
    """

    solver: IkSolver
    policy: Policy
    task: Task
    raw: Backend
    backend: Backend
    dt: float
    seconds: float = math.inf
    seed: int = 0
    pace: Pace = field(default_factory=Pace)
    guards: Guards = field(default_factory=Guards)
    real_time: bool = True
    clocks: Clocks = field(default_factory=Clocks)
