"""The fit of a robot's response and noise to logs of its commands and measurements.

`kinfeas.sim2real.identify.model` predicts the response to the recorded commands. The fit compares
displacements of the base between measurements, and positions of the arm, with the measured ones;
the residuals are noise. Intervals are of 95 % and treat blocks of two seconds as independent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinfeas.config import PluginSpec
from kinfeas.core.errors import KinfeasError
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify.arm import ArmProblem
from kinfeas.sim2real.identify.base import (
    BASE_DRAWS,
    LAG,
    LATENCY,
    BaseFit,
    BaseProblem,
    Parameter,
)
from kinfeas.sim2real.identify.log import Log
from kinfeas.sim2real.identify.model import Delays, Track, arm_delay
from kinfeas.sim2real.identify.statistics import (
    DRIVE,
    NORMAL,
    SLACK,
    SLACK_JERK,
    Estimate,
    base_noise,
    lag_estimate,
    sensor_ages,
    time_estimate,
)

_FAST = 0.8  # m/s^2 and rad/s^2 of a fast start or turn

_ORDER = (
    "base_noise", "actuator_lag", "acceleration_limit", "velocity_clamp", "joint_limit_clamp",
    "dropped_commands", "command_latency", "joint_noise", "localisation", "sensor_latency",
)  # fmt: skip
"""Order of adapters, from the robot outwards, as in `harsh`."""

_OF_ROBOT = ("velocity_clamp", "joint_limit_clamp")
"""Adapters whose parameters are limits of the robot."""


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A fitted robot."""

    # with 95 % intervals, by adapter and parameter, such as `actuator_lag.base`, in SI units
    estimates: dict[str, Estimate]
    response: ResponseModel  # response of the robot: what does not show is left out
    missing: tuple[str, ...]  # what the logs do not show, in sentences
    times: tuple[Array, ...]  # of measured velocities, seconds, shape (k,) for each log
    measured: tuple[Array, ...]  # velocities of the base in world axes, (k, 3), m/s and rad/s
    predicted: tuple[Array, ...]  # velocities that the fitted robot has

    @property
    def adapters(self) -> tuple[PluginSpec, ...]:
        """The estimates as adapters, with their intervals as ranges, the first one innermost.

        Those whose parameters are all zero are left out.
        """
        specs = []
        for name in _ORDER:
            parameters: dict[str, object] = {
                key.partition(".")[2]: _range(estimate)
                for key, estimate in self.estimates.items()
                if key.partition(".")[0] == name
            }
            if any(parameters.values()) or name in _OF_ROBOT:
                specs.append(PluginSpec(name, parameters))
        return tuple(specs)


def fit(logs: Sequence[Log], walk: Sequence[float]) -> ResponseFit:
    """Return the robot fitted to logs with equal control periods.

    The error of the base pose is a random walk, of noise on the base's velocity and of drift of its
    localisation. Both look alike, so that the drift is given: `walk` is its standard deviation
    after 1 s, in metres and radians.
    """
    dt, estimates, missing = logs[0].dt, dict[str, Estimate](), list[str]()
    arm, tracks = ArmProblem(logs), [Track(log) for log in logs]
    delays, error = arm.fit() if arm.moves else (None, np.inf)
    problem = BaseProblem(tracks)
    base = problem.fit(delays, error)
    model = base.model
    latency = base.errors.get(LATENCY, error)
    if delays is not None and problem.moves and not base.agrees:
        arm.fit_lag(model.delays)
    delays = model.delays if problem.moves else delays
    if delays is None:
        sources = ", ".join(log.source for log in logs)
        raise KinfeasError(f"{sources}: neither base nor arm moves; {DRIVE}")
    # If the arm's latency differs, its delays say nothing about the base's commands.
    spread = arm.spread(delays) if arm.moves and (base.agrees or not problem.moves) else None
    if spread is None and arm.moves:
        missing.append(
            "base and arm differ in their latency: that of the base is given, without its jitter"
        )
    estimates |= _delays(delays, latency, spread, dt)
    velocities = [model.velocities(track.log, BASE_DRAWS) for track in tracks]
    if problem.moves:
        estimates |= _limits(base, _fastest(velocities, dt), missing, dt)
    else:
        missing.append(f"the base does not move: its lag and limits are unknown; {DRIVE}")
    if arm.moves:
        late = float(np.mean([arm_delay(dt, log.arm_seconds) for log in logs]))
        error = 0.5 * dt if arm.lag < 0.5 * dt else arm.error  # as in `lag_estimate`
        estimates["actuator_lag.arm"] = lag_estimate(arm.lag + late, error, dt)
    else:
        missing.append(f"no arm motion: arm lag and lost commands unknown; {DRIVE}")
    if arm.noise is not None:
        estimates["joint_noise.deviation"] = arm.noise
    else:
        missing.append(f"the arm is never at rest: joint noise unknown; {DRIVE}")
    estimates |= base_noise(tracks, velocities, walk, missing)
    estimates |= sensor_ages(logs, missing)
    unknown = [
        key for key, each in estimates.items() if not np.isfinite([each.low, each.high]).all()
    ]
    for key in unknown:
        del estimates[key]
        missing.append(f"the record does not show {key!r}; {DRIVE}")
    seconds = [track.seconds[:, np.newaxis] for track in tracks]
    return ResponseFit(
        estimates, _response(estimates, delays.mean(dt)), tuple(missing),
        tuple(track.times for track in tracks),
        tuple(track.moved / s for track, s in zip(tracks, seconds, strict=True)),
        tuple(
            track.predicted(v) / s for track, v, s in zip(tracks, velocities, seconds, strict=True)
        ),
    )  # fmt: skip


def _delays(
    delays: Delays, error: float, spread: tuple[Estimate, Estimate, float] | None, dt: float
) -> dict[str, Estimate]:
    if spread is None:
        return {"command_latency.seconds": time_estimate(delays.mean(dt), error)}
    jitter, lost, spread_error = spread
    latency = max(0.0, delays.spread(jitter.value, lost.value, dt).latency)
    return {
        "dropped_commands.probability": lost,
        "command_latency.seconds": time_estimate(latency, float(np.hypot(error, spread_error))),
        "command_latency.jitter": jitter,
    }


def _limits(base: BaseFit, fastest: Array, missing: list[str], dt: float) -> dict[str, Estimate]:
    """Return lag and limits of a base; `fastest` are its largest predicted accelerations, (2,)."""
    estimates: dict[str, Estimate] = {}
    lag = base.model.lag
    lag_error = base.errors[LAG] * lag
    if lag < 0.5 * dt or lag_error < 0.1:
        estimates["actuator_lag.base"] = lag_estimate(lag, lag_error, dt)
    else:
        missing.append(f"no fast change of the base's velocity: its lag is unknown; {DRIVE}")
    parts = ((0, "linear", "start or stop", "m/s^2"), (1, "angular", "turn", "rad/s^2"))
    for part, name, change, unit in parts:
        acceleration, jerk = Parameter("acceleration", part), Parameter("jerk", part)
        for limit, key, slack in (
            (acceleration, name, SLACK), (jerk, f"{name}_jerk", SLACK_JERK)
        ):  # fmt: skip
            if (error := base.errors.get(limit, np.inf)) < 0.5:
                value = float(getattr(base.model, limit.kind)[part])
                factor = float(np.exp(NORMAL * error + slack))
                estimate = Estimate(value, value / factor, value * factor)
                estimates[f"acceleration_limit.{key}"] = estimate
            elif limit == acceleration and fastest[part] > _FAST:
                missing.append(
                    f"no limit of the {name} acceleration shows up to {fastest[part]:.2g} {unit}"
                )
            elif limit == acceleration:
                missing.append(f"no fast {change}: {name} acceleration unknown; {DRIVE}")
    return estimates


def _fastest(velocities: Sequence[Array], dt: float) -> Array:
    """Return the largest linear and angular acceleration of velocities, shape (2,)."""
    rates = np.abs(np.concatenate([np.diff(each, axis=0) for each in velocities])) / dt
    return np.array([rates[:, :2].max(), rates[:, 2].max()])


def _response(estimates: Mapping[str, Estimate], latency: float) -> ResponseModel:
    """Return the model of the estimates, with mean delays; `latency` is that of commands, s."""
    names = {
        "base_lag": "actuator_lag.base", "arm_lag": "actuator_lag.arm",
        "acceleration": "acceleration_limit.linear", "jerk": "acceleration_limit.linear_jerk",
        "rotation_acceleration": "acceleration_limit.angular",
        "rotation_jerk": "acceleration_limit.angular_jerk",
    }  # fmt: skip
    values = {key: estimates[name].value for key, name in names.items() if name in estimates}
    if "sensor_latency.seconds" in estimates:
        jitter = estimates["sensor_latency.jitter"].value
        values["sensor_latency"] = estimates["sensor_latency.seconds"].value + jitter / 2.0
    if "command_latency.seconds" in estimates:
        values["command_latency"] = max(0.0, latency)
    return ResponseModel(**values)


def _range(estimate: Estimate) -> float | list[float]:
    low, high = (float(f"{end:.3g}") for end in (estimate.low, estimate.high))
    return low if low == high else [low, high]
