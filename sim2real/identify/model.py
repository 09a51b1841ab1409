"""The response of a robot to commands, as the adapters have it, and its track in a log.

Commands are late, lost, limited in acceleration and jerk, and lag; see `kinfeas.sim2real.adapters`.
The kernels here are of one robot, and their parameters may vary freely.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numba import njit

from kinfeas.backends.physics.drives import cubic
from kinfeas.control.response import advance
from kinfeas.core.spatial import Array, interpolated_columns
from kinfeas.sim2real.adapters.timing import durations
from kinfeas.sim2real.identify.log import Log

_SHORTEST = 0.6  # periods between measured poses

_OFFSETS = (np.arange(32) + 0.5) / 32.0
"""Fractions of a period at which the active command is looked up."""

_NARROW = 0.125  # periods of jitter at least, so that weights change smoothly with the latency
_LOST = 16  # commands lost in a row that are considered


@njit(cache=True)
def delayed(commands, weights):
    """Return the mean active command of each period, (n, w), for the commands sent, (n, w).

    `weights`, (k,), are those of `Delays.weights`. Before the log, its first command was active.
    """
    active = np.zeros_like(commands)
    for i in range(len(commands)):
        for k in range(len(weights)):
            sent = max(i - k, 0)
            for axis in range(commands.shape[1]):
                active[i, axis] += weights[k] * commands[sent, axis]
    return active


@njit(cache=True)
def moved_base(commands, dt, lag, acceleration, jerk):
    """Return the base's mean velocity in each period, (n, 3), under active commands, (n, 3).

    `acceleration` and `jerk` are the limits of translation and rotation, shape (2,); `lag` is in
    seconds.
    """
    means, motion, moved = np.empty_like(commands), np.zeros(9), np.empty(3)
    limits = np.array([lag, acceleration[0], acceleration[1], jerk[0], jerk[1]])
    for i in range(len(commands)):
        moved[:] = 0.0
        advance(motion, commands[i], dt, limits, moved)
        means[i] = moved / dt
    return means


@njit(cache=True)
def moved_arm(targets, dt, lag, seconds=0.0):
    """Return joint positions at the ends of periods, (n, j), under active targets, (n, j).

    In each period the arm begins a cubic to the lagging target that ends at rest after `seconds`.
    """
    positions, seconds = np.empty_like(targets), max(seconds, dt)
    decay = np.exp(-dt / lag) if lag > 0.0 else 0.0
    aim, speed = targets[0].copy(), np.zeros(targets.shape[1])
    for i in range(len(targets)):
        for k in range(targets.shape[1]):
            aim[k] = targets[i, k] + (aim[k] - targets[i, k]) * decay
            at = positions[i - 1, k] if i > 0 else targets[0, k]
            positions[i, k], speed[k] = cubic(at, speed[k], aim[k] - at, seconds, dt)
    return positions


def arm_delay(dt: float, seconds: float) -> float:
    """Return the delay, s, of an arm on the cubics of `moved_arm` at constant velocity."""
    s = min(dt / seconds, 1.0) if seconds > 0.0 else 1.0
    return seconds * ((4.0 - 3.0 * s) / (6.0 - 6.0 * s + s * s) - s)


@cache
def uniform_numbers(draws: int, n: int) -> Array:
    """Return the same uniform numbers for each fit, shape (draws, n, 2)."""
    return np.random.default_rng(0).random((draws, n, 2))


@njit(cache=True)
def drawn_delays(uniform, dt, latency, jitter, lost):
    """Return one draw of `Delays` for n periods, from uniform numbers in [0, 1), shape (n, 2).

    The active command of a period is a mean of the last k commands: returned are their weights,
    the newest last, shape (n, k), and whether the mean is not lost, shape (n,).
    """
    n, slots = len(uniform), int(np.ceil((latency + jitter) / dt)) + 2
    begins = np.zeros((n, slots))
    for sent in range(n):
        arrival = sent + (latency + jitter * uniform[sent, 0]) / dt
        for k in range(min(slots, n - sent)):
            begins[sent + k, slots - 1 - k] = min(max(arrival - (sent + k), 0.0), 1.0)
    return durations(begins), uniform[:, 1] >= lost


@njit(cache=True)
def drawn_commands(commands, mixed, kept):
    """Return the active commands, (n, w), for the weights and kept periods of `drawn_delays`."""
    active = np.empty_like(commands)
    for i in range(len(commands)):
        for axis in range(commands.shape[1]):
            if kept[i]:
                value = 0.0
                for k in range(mixed.shape[1]):
                    weight = mixed[i, mixed.shape[1] - 1 - k]
                    if weight > 0.0:
                        value += weight * commands[max(i - k, 0), axis]
                active[i, axis] = value
            else:
                active[i, axis] = active[i - 1, axis] if i > 0 else commands[0, axis]
    return active


@njit(cache=True)
def mean_moved_base(commands, dt, latency, jitter, lost, lag, acceleration, jerk, uniform):
    """Return the mean of `moved_base`, (n, 3), over draws from uniform numbers, (draws, n, 2)."""
    total = np.zeros_like(commands)
    for numbers in uniform:
        mixed, kept = drawn_delays(numbers, dt, latency, jitter, lost)
        active = drawn_commands(commands, mixed, kept)
        total += moved_base(active, dt, lag, acceleration, jerk)
    return total / len(uniform)


@dataclass(frozen=True)
class Delays:
    """Delays of commands."""

    latency: float  # minimum delay, seconds
    jitter: float = 0.0  # width of the uniform distribution of additional delays, seconds
    lost: float = 0.0  # probability that a command is lost

    def weights(self, dt: float) -> Array:
        """Return the mean weight of each command in a period, shape (k,), the newest first."""
        width = max(self.jitter, _NARROW * dt)
        first = self.latency + 0.5 * (self.jitter - width)
        count = int(np.ceil(max(first + width, 0.0) / dt)) + 2
        ages = (_OFFSETS[:, np.newaxis] + np.arange(count)) * dt
        arrived = np.clip((ages - first) / width, 0.0, 1.0)
        earlier = np.cumprod(1.0 - arrived, axis=1)
        active = arrived * np.concatenate([np.ones((len(ages), 1)), earlier[:, :-1]], axis=1)
        weights, lost = active.mean(axis=0), self.lost
        if lost > 0.0:
            return np.convolve(weights, (1.0 - lost) * lost ** np.arange(_LOST))
        return weights

    def mean(self, dt: float) -> float:
        """Return the mean delay, seconds."""
        weights = self.weights(dt)
        return float(weights @ np.arange(len(weights))) * dt

    def spread(self, jitter: float, lost: float, dt: float) -> "Delays":
        """Return delays with another jitter and probability of loss, and the same mean."""
        other = Delays(self.latency, jitter, lost)
        return replace(other, latency=self.latency + self.mean(dt) - other.mean(dt))


@dataclass(frozen=True)
class BaseModel:
    """Response of a base: delays, lag in s, and limits (2,) of translation and rotation or inf."""

    delays: Delays
    lag: float
    acceleration: Array
    jerk: Array

    def velocities(self, log: Log, draws: int = 0) -> Array:
        """Return the mean velocity in each period of a log, shape (n, 3).

        It is the response to the mean active command or, more exactly since limits are not linear,
        the mean response to `draws` of the delays.
        """
        limits = self.lag, self.acceleration, self.jerk
        if not draws:
            active = delayed(log.twists, self.delays.weights(log.dt))
            return moved_base(active, log.dt, *limits)
        delays = max(0.0, self.delays.latency), self.delays.jitter, self.delays.lost
        numbers = uniform_numbers(draws, len(log.twists))
        return mean_moved_base(log.twists, log.dt, *delays, *limits, numbers)


class Track:
    """Displacements of the base between the measurements of a log, shape (k, 3), m and rad.

    Attributes:
        moved: Measured displacements.
        seconds: Duration of each, shape (k,).
        times: Middle of each, seconds, shape (k,).
        squares: Variance of each, shape (k,), s^2, if the velocity has noise of variance 1 that is
            constant in each control period: the sum of the squared durations in these periods.
    """

    def __init__(self, log: Log) -> None:
        self.log = log
        self._at = np.clip(log.base_times / log.dt, 0.0, len(log.twists))
        # Leaves measurements out: in short displacements, errors of their times would dominate.
        rows, last = [0], float(self._at[0])
        for row, at in enumerate(self._at.tolist()):
            if at - last >= _SHORTEST:
                rows.append(row)
                last = at
        self._at = self._at[rows]
        self.moved = np.diff(log.base[rows], axis=0)
        begin, end = self._at[:-1], self._at[1:]
        self.seconds, self.times = (end - begin) * log.dt, 0.5 * (begin + end) * log.dt
        squares, first = np.zeros(len(begin)), np.floor(begin)
        for k in range(int(np.ceil((end - begin).max())) + 2):
            overlap = np.minimum(end, first + k + 1.0) - np.maximum(begin, first + k)
            squares += np.clip(overlap, 0.0, None) ** 2
        self.squares: Array = squares * log.dt**2

    def predicted(self, velocities: Array) -> Array:
        """Return the displacements, (k, 3), at a velocity for each control period, shape (n, 3)."""
        path = np.concatenate([np.zeros((1, 3)), np.cumsum(velocities, axis=0) * self.log.dt])
        at = interpolated_columns(self._at, np.arange(float(len(path))), path)
        return np.diff(at, axis=0)
