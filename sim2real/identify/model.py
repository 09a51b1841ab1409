"""Delays of commands, the response of a base to them, and its track in a log."""

from dataclasses import dataclass, replace

import numpy as np

from kinfeas.core.spatial import Array, interpolated_columns
from kinfeas.sim2real.identify import chain
from kinfeas.sim2real.identify.log import Log

_SHORTEST = 0.6  # periods between measured poses

_OFFSETS = (np.arange(32) + 0.5) / 32.0
"""Fractions of a period at which the active command is looked up."""

_NARROW = 0.125  # periods of jitter at least, so that weights change smoothly with the latency
_LOST = 16  # commands lost in a row that are counted


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
        """Return delays with the same mean."""
        other = Delays(self.latency, jitter, lost)
        return replace(other, latency=self.latency + self.mean(dt) - other.mean(dt))


@dataclass(frozen=True)
class BaseModel:
    """Response of a base: delays, lag, and limits (2,) of translation and rotation."""

    delays: Delays
    lag: float
    acceleration: Array
    jerk: Array

    def velocities(self, log: Log, draws: int = 0) -> Array:
        """Return the mean velocity in each period of a log, shape (n, 3).

        That of the mean active command or, since limits are not linear, the mean of `draws`.
        """
        limits = self.lag, self.acceleration, self.jerk
        if not draws:
            active = chain.delayed(log.twists, self.delays.weights(log.dt))
            return chain.moved_base(active, log.dt, *limits)
        delays = max(0.0, self.delays.latency), self.delays.jitter, self.delays.lost
        numbers = chain.uniform_numbers(draws, len(log.twists))
        return chain.mean_moved_base(log.twists, log.dt, *delays, *limits, numbers)


class Track:
    """Displacements of the base between the measurements of a log, shape (k, 3), m and rad.

    Attributes:
        moved: Measured displacements.
        seconds: Duration of each, shape (k,).
        squares: Sum of the squared durations in each period, of which the variance consists where
            the velocity has noise that is constant in each, and measurements are interpolated.
    """

    def __init__(self, log: Log) -> None:
        self.log = log
        self._at = np.clip(log.base_times / log.dt, 0.0, len(log.twists))
        # Errors of times would be large in short displacements.
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
        """Return the displacements at a velocity for each period, shape (n, 3)."""
        path = np.concatenate([np.zeros((1, 3)), np.cumsum(velocities, axis=0) * self.log.dt])
        at = interpolated_columns(self._at, np.arange(float(len(path))), path)
        return np.diff(at, axis=0)
