"""The list of adapters that a fitted robot is, in the form of `configs/sim2real`."""

from collections.abc import Mapping

from kinfeas.config import PluginSpec
from kinfeas.sim2real.identify.statistics import Estimate

_ORDER = (
    "base_noise", "actuator_lag", "acceleration_limit", "velocity_clamp", "joint_limit_clamp",
    "dropped_commands", "command_latency", "joint_noise", "localisation", "sensor_latency",
)  # fmt: skip
"""From the robot outwards, as in `harsh`."""

_OF_ROBOT = ("velocity_clamp", "joint_limit_clamp")
"""Adapters whose parameters are limits of the robot."""


def adapter_list(estimates: Mapping[str, Estimate]) -> tuple[PluginSpec, ...]:
    """Return the adapters of a robot, with the intervals of the estimates as ranges."""
    specs = []
    for name in _ORDER:
        parameters: dict[str, object] = {
            key.partition(".")[2]: _range(estimate)
            for key, estimate in estimates.items()
            if key.partition(".")[0] == name
        }
        if parameters or name in _OF_ROBOT:
            specs.append(PluginSpec(name, parameters))
    return tuple(specs)


def _range(estimate: Estimate) -> float | list[float]:
    low, high = (float(f"{end:.3g}") for end in (estimate.low, estimate.high))
    return low if low == high else [low, high]
