"""What the guards allow, as YAML says it."""

import math
from dataclasses import dataclass, replace

from kinfeas.config.quantities import Count, Positive, PositiveSeconds, PositiveShare
from kinfeas.core.errors import KinfeasError


@dataclass(frozen=True)
class Guards:
    """When a run is refused or stopped, and what commands are brought down to.

    Attributes:
        reach: Whether a run begins only if a base pose is found from which the arm comes to the end
            of each sub-goal. That is a search: what it does not find is most likely out of reach.
        max_age: Seconds that a measurement, and so a command made of it, may be old.
        max_period: Seconds that a control period may take.
        max_clock_skew: Seconds by which the system's clock may be set during a control period, and
            by which a measurement may come from the future.
        max_distance: Metres that the base may be away from its start.
        max_tilt: Radians that the base may lean.
        pose_jump: Metres by which the measured base may jump, beyond what it can have driven.
        heading_jump: The same in radians.
        joint_tolerance: Radians or metres that a measured joint may be beyond its limits.
        max_linear_velocity: Of the base, m/s; the robot's own limit, which is never exceeded, where
            null.
        max_angular_velocity: The same, rad/s.
        acceleration: The same, m/s^2.
        rotation_acceleration: The same, rad/s^2.
        joint_speed: Share of its velocity limit that an arm joint may be commanded to use.
        joint_jump: Radians or metres beyond which an arm joint is not sent to a target that
            joint_jump: the arm stays. Smaller jumps are slowed down to what the arm can follow.
        max_tracking_delay: Seconds that a joint, as fast as it may, needs from where it is measured
            to where it was sent last, beyond which the arm is not sent on: it stays until it has
            followed.
        max_consecutive_ik_failures: Control periods in a row without an IK solution, or with an arm
            that stays for one of these two reasons, after which the run is stopped.
        watchdog: Seconds without a sign of life after which another process stops the base; null
            for none.
    """

    reach: bool = True
    max_age: PositiveSeconds = 0.2
    max_period: PositiveSeconds = 0.2
    max_clock_skew: PositiveSeconds = 0.1
    max_distance: Positive = 20.0
    max_tilt: Positive = 0.15
    pose_jump: Positive = 0.3
    heading_jump: Positive = 0.5
    joint_tolerance: Positive = 0.1
    max_linear_velocity: Positive | None = None
    max_angular_velocity: Positive | None = None
    acceleration: Positive | None = None
    rotation_acceleration: Positive | None = None
    joint_speed: PositiveShare = 1.0
    joint_jump: Positive = 3.2
    max_tracking_delay: PositiveSeconds = 0.5
    max_consecutive_ik_failures: Count = 50
    watchdog: PositiveSeconds | None = 0.2

    def timeless(self) -> "Guards":
        """Return the same without what asks a clock, for worlds that do not keep to one."""
        never = math.inf
        return replace(self, max_age=never, max_period=never, max_clock_skew=never, watchdog=None)

    def check_rate(self, dt: float) -> None:
        """Do nothing if control periods of `dt` seconds leave the guards quiet.

        Raises:
            KinfeasError: If they would set one off.
        """
        for name in ("max_age", "max_period", "watchdog"):
            seconds = getattr(self, name)
            if seconds is not None and seconds < 1.5 * dt:
                raise KinfeasError(
                    f"guards.{name} of {seconds:g} s needs a rate of at least "
                    f"{1.5 / seconds:g} Hz, not {1.0 / dt:g} Hz"
                )
