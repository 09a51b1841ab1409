"""Sub-goals, their tolerances, and how motions are executed."""

import math
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from kinfeas.config.quantities import SLOWEST, Distance, Seconds, SlowDown
from kinfeas.core import spatial
from kinfeas.core.backend import Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

Frame = Literal["ee", "tip"]

GRASP_METRES, GRASP_SETTLE_TIME = 0.005, 5.0
"""How near a gripper comes to the end of a sub-goal before it acts, and how long it may take."""

RECONFIGURATION_SECONDS, ARM_SETTLE_TIMEOUT = 0.15, 8.0
"""From how far away at its greatest speed an arm swings to another configuration, rather than lags
behind a motion, and how long that may take."""


@dataclass(frozen=True)
class SubgoalMotion:
    """One sub-goal of a motion sequence, ready to run.

    Attributes:
        generator: Moves the frame; sub-goals may share one.
        frame: Whether it moves the EE frame or the tool tip in the common gripper convention.
        dwell: Seconds that the EE stands still after its arrival, unless it is the last sub-goal.
        grip: What the gripper does then.
        name: What errors call the generator; its class by default.
    """

    generator: MotionGenerator
    frame: Frame = "ee"
    dwell: float = 0.0
    grip: Grip | None = None
    name: str = ""


@dataclass(frozen=True)
class ExecutionConfig:
    """How a robot with inertia carries motions out.

    Attributes:
        slow_down: How many times longer than planned they last; waits do not.
        head_start: Seconds that the EE stands still at first, while the base moves already.
        grasp_settle_time: Motion seconds for which a sub-goal that ends with a grip goes on after
            the arrival, to bring the EE within `GRASP_METRES` of the end.
        head_start_jitter: Seconds by which the head start is longer at most, drawn for each
            episode.
        arm_settle_timeout: Seconds for which motion and base stand still at most, while the arm
            swings to another configuration that is further away than `RECONFIGURATION_SECONDS`.
        feasibility_filter: Whether the base yields where the arm could not follow: see
            `FeasibilityFilter`.
        min_obstacle_distance: Metres that the base keeps from what stands around, which the backend
            has to know then; 0 for a base that does not look.
    """

    slow_down: SlowDown = 1.0
    head_start: Seconds = 0.0
    grasp_settle_time: Seconds = 0.0
    head_start_jitter: Seconds = 0.0
    arm_settle_timeout: Seconds = 0.0
    feasibility_filter: bool = False
    min_obstacle_distance: Distance = 0.0

    def __post_init__(self) -> None:
        """Check what adapters may have multiplied."""
        if self.slow_down not in SLOWEST:
            raise KinfeasError(
                f"slow_down must be a number {SLOWEST} in all, not {self.slow_down:g}"
            )
        for name in ("head_start", "grasp_settle_time", "head_start_jitter", "arm_settle_timeout"):
            seconds = getattr(self, name)
            if not 0.0 <= seconds < math.inf:
                raise KinfeasError(f"{name} must be a number >= 0 in all, not {seconds:g}")


@dataclass(frozen=True)
class ExecutionSettings:
    """What can be set of the pace of a robot with inertia.

    Attributes:
        slow_down: How many times longer than planned the EE motions last.
        head_start: Seconds that the EE stands still at first, while the base moves already.
        arm_settle_timeout: Seconds for which motion and base wait at most for an arm that swings to
            another configuration.
        feasibility_filter: Whether the base takes the nearest command that the arm can follow where
            it cannot follow the policy's.
        min_obstacle_distance: Metres that the base keeps from what the backend knows to stand
            around; 0 for a base that does not look.
    """

    slow_down: SlowDown = 1.0
    head_start: Seconds = 0.0
    arm_settle_timeout: Seconds = ARM_SETTLE_TIMEOUT
    feasibility_filter: bool = False
    min_obstacle_distance: Distance = 0.0

    @property
    def execution(self) -> ExecutionConfig:
        """How EE motions are carried out."""
        return ExecutionConfig(
            self.slow_down,
            self.head_start,
            GRASP_SETTLE_TIME,
            arm_settle_timeout=self.arm_settle_timeout,
            feasibility_filter=self.feasibility_filter,
            min_obstacle_distance=self.min_obstacle_distance,
        )


@runtime_checkable
class ExecutionAdapter(Protocol):
    """An adapter that leaves commands alone and changes how motions are carried out."""

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the pace that `execution` becomes."""
        ...


def tool_pose(robot: Robot) -> Array:
    """Return the tool tip, x the approach and y the finger axis, in the EE frame, shape (7,)."""
    x, y, z, w = robot.gripper_rotation
    return np.concatenate([robot.tool_tip, spatial.canonical(np.array([-x, -y, -z, w]))])
