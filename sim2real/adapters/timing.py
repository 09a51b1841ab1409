"""Timing: late or lost commands, late measurements, head start and time scale of EE motions.

Buffers hold the last commands or measurements of each row, the newest at the end.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from annotated_types import Interval
from numba import njit
from numpy.typing import NDArray

from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.quantities import TIME_SCALES
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array, integrate, twist_between
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.sim2real.adapters.adapter import Adapter, Memory, Number, measured

# Tolerances of rounding: in control periods and in seconds.
_PERIOD_TOLERANCE, _TIME_TOLERANCE = 1e-6, 1e-7

_DELAYS = Interval(ge=0.0, le=60.0)

_POSES, _JOINTS = ("base_pose", "ee_in_base"), "joint_positions"
_MEASURED = (*_POSES, _JOINTS, "base_twist", "joint_velocities", "age")


class CommandLatency(Adapter):
    """Delayed commands; the robot rests until the first one arrives.

    The newest command that has arrived is active. If it changes within a control period, the
    time-weighted mean is passed on.

    Args:
        seconds: Minimum delay of a command, s.
        jitter: Maximum additional delay, s, uniform and independent for each command.
    """

    late = True

    def __init__(
        self, backend: Backend, robot: Robot, *, seconds: Number = 0.06, jitter: Number = 0.0
    ) -> None:
        super().__init__(backend, robot, {"seconds": seconds, "jitter": jitter}, _DELAYS)
        delay = self.mean("seconds") + 0.5 * self.mean("jitter")
        self.response = backend.response.within(ResponseModel(command_latency=delay))

    def on_reset(self, state: RobotState) -> Memory:
        """Return buffers full of commands to rest."""
        slots = self.memory["arrivals"].shape[1] if self.memory else 1
        joints = state.joint_positions
        return {
            "clock": np.zeros(len(joints)), "arrivals": np.full((len(joints), slots), -np.inf),
            "twists": np.zeros((len(joints), slots, 6)), "targets": filled(joints, slots),
        }  # fmt: skip

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the active command."""
        slots = slots_for(self.ranges["seconds"].high + self.ranges["jitter"].high, dt)
        delay = self.number("seconds") + self.number("jitter") * self.uniform(1)
        now = self.memory["clock"]
        arrivals = pushed(self.memory["arrivals"], now + delay[:, 0], slots)
        twists = pushed(self.memory["twists"], twist, slots)
        joints = pushed(self.memory["targets"], targets, slots)
        self.remember(clock=now + dt, arrivals=arrivals, twists=twists, targets=joints)
        steps = np.round((arrivals - now[:, np.newaxis]) / dt / _PERIOD_TOLERANCE)
        weights = durations(np.clip(steps * _PERIOD_TOLERANCE, 0.0, 1.0))
        straight = np.zeros(6, dtype=np.bool_)
        # A copy, because numba compiles kernels again for read-only arrays.
        active = self.joints(mixed(joints, weights, self.continuous.copy()))
        return mixed(twists, weights, straight), active


class SensorLatency(Adapter):
    """Delayed measurements, interpolated between control periods.

    A measurement is never older than the one before it.

    Args:
        seconds: Minimum delay of a measurement, s.
        jitter: Maximum additional delay, s, uniform and independent for each measurement.
    """

    late = True

    def __init__(
        self, backend: Backend, robot: Robot, *, seconds: Number = 0.03, jitter: Number = 0.0
    ) -> None:
        super().__init__(backend, robot, {"seconds": seconds, "jitter": jitter}, _DELAYS)
        delay = self.mean("seconds") + 0.5 * self.mean("jitter")
        self.response = backend.response.within(ResponseModel(sensor_latency=delay))

    def on_reset(self, state: RobotState) -> Memory:
        """Return buffers full of the current measurement."""
        slots = self.memory["times"].shape[1] if self.memory else 1
        n = len(state.base_pose)
        times = np.full((n, slots), -np.inf)
        times[:, -1] = 0.0
        buffers = {name: filled(values, slots) for name, values in _measurements(state).items()}
        return {"clock": np.zeros(n), "shown": np.zeros(n), "times": times, **buffers}

    def on_step(self, state: RobotState, dt: float) -> None:
        """Append the measurement and advance the time of the shown one."""
        slots = slots_for(self.ranges["seconds"].high + self.ranges["jitter"].high, dt)
        delay = self.number("seconds") + self.number("jitter") * self.uniform(1)
        clock = self.memory["clock"] + dt
        shown = np.maximum(self.memory["shown"], clock - delay[:, 0])
        times = pushed(self.memory["times"], clock, slots)
        buffers = {}
        for name, values in _measurements(state).items():
            buffer = self.memory.get(name)
            before = filled(values, times.shape[1] - 1) if buffer is None else buffer
            buffers[name] = pushed(before, values, slots)
        self.remember(clock=clock, shown=shown, times=times, **buffers)

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the delayed state with its age."""
        index, fraction = bracket(self.memory["times"], self.memory["shown"])
        names = [name for name in _MEASURED if name in self.memory]
        delayed = {name: self._between(name, index, fraction) for name in names}
        age = self.memory["clock"] - self.memory["shown"]
        delayed["age"] = age + delayed["age"] if "age" in delayed else age
        return measured(state, **delayed)

    def _between(self, name: str, index: NDArray[np.intp], fraction: Array) -> Array:
        buffer, rows = self.memory[name], np.arange(len(index))
        fraction = fraction.reshape(-1, *(1 for _ in buffer.shape[2:]))
        before = buffer[rows, index]
        after = buffer[rows, np.minimum(index + 1, buffer.shape[1] - 1)]
        if name in _POSES:
            moved = integrate(before, twist_between(before, after, 1.0) * fraction, 1.0)
        elif name == _JOINTS:
            moved = self.joints(before + joint_displacement(self.robot, before, after) * fraction)
        else:
            moved = before + (after - before) * fraction
        return np.where(fraction > 0.0, moved, before)


class DroppedCommands(Adapter):
    """Lost commands; the robot continues with the last one that arrived.

    Args:
        probability: Probability that a command is lost, 0-1.
    """

    def __init__(self, backend: Backend, robot: Robot, *, probability: Number = 0.05) -> None:
        super().__init__(backend, robot, {"probability": probability}, Interval(ge=0.0, le=1.0))

    def on_reset(self, state: RobotState) -> Memory:
        """Return the command to rest."""
        joints = state.joint_positions
        return {"twist": np.zeros((len(joints), 6)), "targets": joints}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the command, or the last one that arrived."""
        lost = self.uniform(1) <= self.number("probability")
        twist = np.where(lost, self.memory["twist"], twist)
        targets = np.where(lost, self.memory["targets"], targets)
        self.remember(twist=twist, targets=targets)
        return twist, targets


class HeadStart(Adapter):
    """EE motions that start after the base does.

    Args:
        seconds: Time in seconds for which the EE is at rest; added to other head starts.
    """

    def __init__(self, backend: Backend, robot: Robot, *, seconds: Number = 3.0) -> None:
        super().__init__(backend, robot, {"seconds": seconds})

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the execution with a longer head start, drawn for each episode from a range."""
        (low, high), inner = self.ranges["seconds"], super().execution(execution)
        jitter = inner.head_start_jitter + high - low
        return replace(inner, head_start=inner.head_start + low, head_start_jitter=jitter)


class TimeScale(Adapter):
    """Slower EE motions than planned; dwells keep their time.

    Args:
        factor: Fraction of the planned speed, 0.001 to 1; multiplied with others. All episodes of a
            batch have the same time scale, so a range raises an error.
    """

    def __init__(self, backend: Backend, robot: Robot, *, factor: Number = 0.5) -> None:
        super().__init__(backend, robot, {"factor": factor}, TIME_SCALES)
        if self.ranges["factor"].low < self.ranges["factor"].high:
            raise ValueError(f"factor is {factor!r}, must be one number for all episodes")

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the slower execution."""
        inner = super().execution(execution)
        return replace(inner, time_scale=inner.time_scale * self.ranges["factor"].low)


def _measurements(state: RobotState) -> dict[str, Array]:
    values = {name: getattr(state, name) for name in _MEASURED}
    return {name: array for name, array in values.items() if array is not None}


def filled(values: NDArray[Any], slots: int) -> NDArray[Any]:
    """Return buffers with the same values in all slots, shape (n, ...) -> (n, slots, ...)."""
    return np.repeat(values[:, np.newaxis], slots, axis=1)


def pushed(buffer: NDArray[Any], values: NDArray[Any], slots: int) -> NDArray[Any]:
    """Return buffers, (n, s, ...), with `values`, (n, ...), appended; at most `slots` entries."""
    return np.concatenate([buffer, values[:, np.newaxis]], axis=1)[:, -slots:]


def slots_for(seconds: float, dt: float) -> int:
    """Return the number of entries, one per `dt` seconds, that span `seconds`."""
    return int(np.ceil(seconds / dt)) + 2


@njit(cache=True)
def durations(begins):
    """Return for how long each command is active, shape (n, s), in periods.

    A command is active from `begins`, shape (n, s), on, 0 to 1 within the period, until one that
    was sent later begins. Commands are in the order of sending.
    """
    active = np.empty_like(begins)
    for i in range(len(begins)):
        end = 1.0
        for k in range(begins.shape[1] - 1, -1, -1):
            active[i, k] = max(end - begins[i, k], 0.0)
            end = min(end, begins[i, k])
        active[i, 0] += end  # until one begins, the oldest is active
    return active


@njit(cache=True)
def mixed(buffer, weights, turning):
    """Return weighted means of buffers, shape (n, s, w) -> (n, w), for weights of shape (n, s).

    A weight of 1 returns its command bit for bit. `turning`, shape (w,), marks continuous joints.
    """
    means = np.empty((len(buffer), buffer.shape[2]))
    for i in range(len(buffer)):
        first = 0
        while weights[i, first] == 0.0:
            first += 1
        for k in range(buffer.shape[2]):
            mean = buffer[i, first, k]
            for j in range(first + 1, buffer.shape[1]):
                if weights[i, j] > 0.0:
                    change = buffer[i, j, k] - buffer[i, first, k]
                    if turning[k]:
                        change -= 2.0 * np.pi * np.round(change / (2.0 * np.pi))
                    mean += weights[i, j] * change
            means[i, k] = mean
    return means


@njit(cache=True)
def bracket(times, moment):
    """Return the index of the measurement before a moment, and the fraction towards the next.

    Times are in seconds and ascending, shape (n, s), and -inf before an episode; moments and
    results have shape (n,).
    """
    index, fraction = np.empty(len(times), dtype=np.intp), np.zeros(len(times))
    for i in range(len(times)):
        k = times.shape[1] - 1
        while k > 0 and times[i, k] > moment[i] + _TIME_TOLERANCE:
            k -= 1
        index[i] = k
        late = moment[i] - times[i, k]
        if k + 1 < times.shape[1] and times[i, k] > -np.inf and late > _TIME_TOLERANCE:
            fraction[i] = late / (times[i, k + 1] - times[i, k])
    return index, fraction
