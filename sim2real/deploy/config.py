"""Configuration of a deployment: guards, execution, and parameters of its parts."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

from annotated_types import Interval

from kinfeas.config import PluginSpec
from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.targets import TargetRules
from kinfeas.core.checks import MAX_TILT
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Count, Positive, PositiveFraction, PositiveSeconds
from kinfeas.kinematics.ik import IkOptions


@dataclass(frozen=True)
class Guards:
    """Limits of measurements and commands."""

    # start only if a base pose is found from which the arm reaches the end of each sub-goal
    reach: bool = True
    # age of a measurement, and of the one behind a command, that stops the run, seconds
    max_age: PositiveSeconds = 0.2
    # age of a scan that stops the run of a policy that uses it, seconds
    max_scan_age: PositiveSeconds = 0.5
    max_period: PositiveSeconds = 0.2  # length of a control period that stops it, seconds
    # change of the system's clock, or stamp in the future, that stops it, seconds
    max_clock_skew: PositiveSeconds = 0.1
    max_distance: Positive = 20.0  # distance of the base from its start that stops it, metres
    # tilt of the base that stops it, radians
    max_tilt: Annotated[float, Interval(gt=0.0, le=MAX_TILT)] = 0.15
    # change of the measured base position, beyond what it can have driven, that stops it, metres
    pose_jump: Positive = 0.3
    heading_jump: Positive = 0.5  # the same of its heading, radians
    # change of a measured joint, beyond twice what it can have moved, that stops it, rad or m
    measured_joint_jump: Positive = 0.3
    # excess of a measured joint beyond its limits that stops it, radians or metres
    joint_tolerance: Positive = 0.1
    # limit of the base command, m/s; the robot's own if null
    max_linear_velocity: Positive | None = None
    max_angular_velocity: Positive | None = None  # the same, rad/s
    acceleration: Positive | None = None  # limit of its change, m/s^2; the robot's own if null
    rotation_acceleration: Positive | None = None  # the same, rad/s^2
    joint_speed: PositiveFraction = 1.0  # fraction of their velocity limits that arm joints may use
    # distance of a joint target beyond which the arm holds, radians or metres
    joint_jump: Positive = 3.2
    # seconds that a joint may need to its last target; beyond, the arm holds until it has caught up
    max_tracking_delay: PositiveSeconds = 0.5
    # control periods in a row without an IK solution, or with the arm on hold, after which the run
    # stops
    max_consecutive_ik_failures: Count = 50
    # seconds without a heartbeat after which another process stops the base; null for no such
    # process
    watchdog: PositiveSeconds | None = 0.2

    def timeless(self) -> "Guards":
        """Return the guards without limits of time, for worlds without a clock."""
        never = math.inf
        ages = replace(self, max_age=never, max_scan_age=never)
        return replace(ages, max_period=never, max_clock_skew=never, watchdog=None)

    def check_rate(self, dt: float) -> None:
        """Raise KinfeasError if control periods of `dt` seconds exceed a limit of time."""
        for name in ("max_age", "max_period", "watchdog"):
            seconds = getattr(self, name)
            if seconds is not None and seconds < 1.5 * dt:
                raise KinfeasError(
                    f"guards.{name} of {seconds:g} s needs a rate of at least "
                    f"{1.5 / seconds:g} Hz, not {1.0 / dt:g} Hz"
                )


@dataclass(frozen=True)
class DeployConfig(ExecutionConfig):
    """Settings of a deployment; see `ExecutionConfig` for those of motions."""

    guards: Guards = field(default_factory=Guards)  # limits of measurements and commands
    # parameters of the motion generator of a goal
    generator: dict[str, object] = field(default_factory=dict)
    task: dict[str, object] = field(default_factory=dict)  # parameters of the task
    backend: dict[str, object] = field(default_factory=dict)  # parameters of the backend
    ik: IkOptions = field(default_factory=IkOptions)  # settings of the IK solver
    # scene around the robot, by name or YAML file, whose furniture motions and IK avoid
    scene: str | None = None
    filters: tuple[PluginSpec, ...] = ()  # command filters, in this order


@dataclass(frozen=True)
class ServoConfig(DeployConfig):
    """Settings of a deployment whose targets move."""

    # limits of targets, and rules for their messages
    rules: TargetRules = field(default_factory=TargetRules)
    # parameters of the source of targets
    source: dict[str, object] = field(default_factory=dict)
