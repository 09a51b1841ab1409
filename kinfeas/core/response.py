"""The response of a robot: how late, and how fast, it carries out its commands."""

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from annotated_types import Interval

from kinfeas.core.quantities import Positive

Delay = Annotated[float, Interval(ge=0.0, le=60.0)]  # bounded, since commands are kept that long


@dataclass(frozen=True)
class ResponseModel:
    """Delays and limits of a robot between commands and measurements; none by default.

    A command arrives after its latency, the base's velocity approaches it within the limits, and
    base and arm follow with a first-order lag.
    """

    command_latency: Delay = 0.0  # seconds until a command takes effect
    sensor_latency: Delay = 0.0  # age of measurements that do not state their age, seconds
    base_lag: Delay = 0.0  # time constant of the base's velocity, seconds
    arm_lag: Delay = 0.0  # time constant of the joint positions, seconds
    # limit of the base's planar acceleration, m/s^2; None for none
    acceleration: Positive | None = None
    rotation_acceleration: Positive | None = None  # the same for the base's rotation, rad/s^2
    jerk: Positive | None = None  # limit of the base's planar jerk, m/s^3; None for none
    rotation_jerk: Positive | None = None  # the same for the base's rotation, rad/s^3

    @property
    def immediate(self) -> bool:
        """Whether commands are carried out at once and exactly."""
        return self == ResponseModel()

    def within(self, outer: "ResponseModel") -> "ResponseModel":
        """Return the response of this robot behind further delays: times add, limits tighten."""
        merged: dict[str, Any] = {}
        for name in (field.name for field in fields(self)):
            inner_value, outer_value = getattr(self, name), getattr(outer, name)
            if inner_value is None or outer_value is None:
                merged[name] = outer_value if inner_value is None else inner_value
            elif name.endswith(("latency", "lag")):
                merged[name] = inner_value + outer_value
            else:
                merged[name] = min(inner_value, outer_value)
        return replace(self, **merged)
