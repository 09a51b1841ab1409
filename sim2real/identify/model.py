"""Delays of commands, the response of a base to them, and its ways between measurements."""

from dataclasses import dataclass, replace

import numpy as np

from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify import chain
from kinfeas.sim2real.identify.log import Log
from kinfeas.sim2real.identify.statistics import interpolated

_SHORTEST = 0.6  # periods between measured poses


@dataclass(frozen=True)
class Delays:
    """Delays of commands: the shortest, seconds, their jitter, and the probability of a loss."""

    latency: float
    jitter: float = 0.0
    lost: float = 0.0

    def weights(self, dt: float) -> Array:
        """Return the mean weights of commands, as `chain.delay_weights`."""
        return chain.delay_weights(self.latency, self.jitter, self.lost, dt)

    def mean(self, dt: float) -> float:
        """Return the mean delay, seconds."""
        return chain.mean_delay(self.weights(dt), dt)

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


class Ways:
    """Ways of the base between measurements, shape (k, 3), m and rad.

    Attributes:
        moved: Measured ways.
        seconds: Duration of each, shape (k,).
        squares: Sum of the squared durations in each period, of which the variance consists where
            the velocity has noise that is constant in each, and measurements are interpolated.
    """

    def __init__(self, log: Log) -> None:
        self.log = log
        self._at = np.clip(log.base_times / log.dt, 0.0, len(log.twists))
        # Errors of times would be large in short ways.
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
        """Return the ways at a velocity for each period, shape (n, 3)."""
        way = np.concatenate([np.zeros((1, 3)), np.cumsum(velocities, axis=0) * self.log.dt])
        at = interpolated(way, self._at)
        return np.diff(at, axis=0)
