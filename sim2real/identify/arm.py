"""The fit of an arm's lag, and of the delays of commands, to its measured positions."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import Bounds, least_squares

from kinfeas.core.spatial import Array, interpolated_columns
from kinfeas.sim2real.identify.base import LATENCIES, LATENCY_UNIT, TIMES
from kinfeas.sim2real.identify.log import Log
from kinfeas.sim2real.identify.model import (
    Delays,
    delayed,
    drawn_commands,
    drawn_delays,
    moved_arm,
    uniform_numbers,
)
from kinfeas.sim2real.identify.statistics import (
    MOVES,
    Estimate,
    derivatives,
    joint_noise,
    overlap,
    posterior,
    standard_errors,
    time_blocks,
)

_DRAWS = 16  # of delays, for the spread that jitter and lost commands cause
_JITTERS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1)
_LOST = (0.0, 0.01, 0.025, 0.05, 0.075, 0.1, 0.13, 0.17)
_FAST = 0.1  # fraction of the largest squared speed from which on time errors are used
_LAGS = 3  # measurements from the first to the second of a pair at most
_USUAL_LOSS = 0.04  # mean of the exponential prior of the probability of a loss
_PAIRS = 0.1  # weight of the likelihood: each measurement is in six pairs, which are correlated


class Positions(NamedTuple):
    """Positions of the joints that move in a log, shape (k, w) each."""

    predicted: Array
    measured: Array
    speed: Array  # predicted velocity, rad/s or m/s


class TimeErrors(NamedTuple):
    """By how much an arm is late in a log, seconds; NaN where it is at rest or slow."""

    late: Array  # shape (k,)
    noise: Array  # variance of `late` by the noise of positions, shape (k,)
    shared: list[Array]  # covariance by it of those 1, 2, ... measurements apart, shape (k - lag,)


class ArmProblem:
    """The fit of an arm's lag and delays to its positions."""

    def __init__(self, logs: Sequence[Log]) -> None:
        self._logs, self._dt = logs, logs[0].dt
        ranges = np.max([np.ptp(log.targets, axis=0) for log in logs], axis=0)
        self._joints = ranges > MOVES
        self.moves = bool(self._joints.any())
        self.lag, self.error = 0.02, np.inf  # time constant and its standard error, seconds
        self._at = [np.clip(log.joint_times / log.dt, 0, len(log.targets)) for log in logs]
        # `noise`, that of measured positions, is None if the arm is never at rest.
        self.noise, variance, interpolated = joint_noise(logs, self._at)

        def correlation(at: Array, lag: int) -> Array:
            return overlap(at, lag) if interpolated else np.full(len(at) - lag, float(lag == 0))

        lags = range(_LAGS + 1)
        # Variance of positions, then covariances of those 1, 2, ... measurements apart.
        self._variances = [[variance * correlation(at, lag) for lag in lags] for at in self._at]
        self._spread = 0.0  # standard deviation of the delays, seconds
        self._blocks = time_blocks([log.joint_times for log in logs])

    def fit(self) -> tuple[Delays, float]:
        """Return the delays and the standard error of the latency, seconds."""
        delays = Delays(0.05)
        for _ in range(2):
            delays, errors = self._solve(delays, latency=True)
            jitter, lost, _ = self.spread(delays)
            delays = delays.spread(jitter.value, lost.value, self._dt)
        delays, errors = self._solve(delays, latency=True)
        return delays, errors

    def fit_lag(self, delays: Delays) -> None:
        """Fit the lag for given delays."""
        self._solve(delays, latency=False)

    def _solve(self, delays: Delays, *, latency: bool) -> tuple[Delays, float]:
        def residuals(z: Array) -> Array:
            shifted = replace(delays, latency=z[1] * LATENCY_UNIT) if latency else delays
            return self._residuals(shifted, float(np.exp(z[0])))

        start = np.array([np.log(self.lag), max(delays.latency, 1e-3) / LATENCY_UNIT])
        bounds = np.array([TIMES, LATENCIES])
        start, bounds = (start, bounds) if latency else (start[:1], bounds[:1])
        for _ in range(2):
            solution = least_squares(
                residuals, start, jac=partial(derivatives, residuals), bounds=Bounds(*bounds.T),
                loss="soft_l1", f_scale=3.0, max_nfev=40, xtol=1e-5,
            )  # fmt: skip
            start, self.lag = solution.x, float(np.exp(solution.x[0]))
            if latency:
                delays = replace(delays, latency=float(solution.x[1]) * LATENCY_UNIT)
            errors_of_logs = self._time_errors(delays)
            late = np.concatenate([errors.late for errors in errors_of_logs])
            variance = np.concatenate([errors.noise for errors in errors_of_logs])
            weights = 1.0 / (variance + self._spread**2)
            spread = np.nansum((late**2 - variance) * weights) / np.nansum(weights)
            self._spread = float(np.sqrt(max(0.0, spread)))
        blocks = np.repeat(self._blocks, int(self._joints.sum()))
        errors = standard_errors(residuals(start), derivatives(residuals, start), blocks)
        self.error = float(errors[0]) * self.lag
        return delays, float(errors[1]) * LATENCY_UNIT if latency else 0.0

    def _positions(self, delays: Delays, lag: float) -> Iterator[Positions]:
        for log, at in zip(self._logs, self._at, strict=True):
            targets = log.targets[:, self._joints]
            active = delayed(targets, delays.weights(log.dt))
            ends = moved_arm(active, log.dt, lag, log.arm_seconds)
            ends = np.concatenate([targets[:1], ends])
            periods, measured = np.arange(float(len(ends))), log.joints[:, self._joints]
            predicted = interpolated_columns(at, periods, ends)
            predicted += np.median(measured - predicted, axis=0)  # an offset is no lateness
            speed = interpolated_columns(at, periods, np.gradient(ends, log.dt, axis=0))
            yield Positions(predicted, measured, speed)

    def _residuals(self, delays: Delays, lag: float) -> Array:
        positions = zip(self._positions(delays, lag), self._variances, strict=True)
        parts = [
            (p - m) / np.sqrt(variances[0][:, np.newaxis] + (self._spread * s) ** 2)
            for (p, m, s), variances in positions
        ]
        return np.concatenate(parts).ravel()

    def _time_errors(self, delays: Delays) -> list[TimeErrors]:
        """Return the time errors of each log."""
        positions, errors = self._positions(delays, self.lag), []
        for (predicted, measured, speed), variances in zip(positions, self._variances, strict=True):
            squared = _moving_square(speed)
            late = np.sum((predicted - measured) * speed, axis=1) / squared
            shared = [
                variances[lag] * np.sum(speed[lag:] * speed[:-lag], axis=1)
                / (squared[lag:] * squared[:-lag])
                for lag in range(1, len(variances))
            ]  # fmt: skip
            errors.append(TimeErrors(late, variances[0] / squared, shared))
        return errors

    def spread(self, delays: Delays) -> tuple[Estimate, Estimate, float]:
        """Return jitter, probability of a loss, and the error of the latency from both, seconds.

        Time errors of the arm are compared with those of simulated delays, by the likelihood of
        pairs of neighbours.
        """
        errors = [  # a constant lateness is no spread
            each._replace(late=each.late - np.nanmean(each.late))
            for each in self._time_errors(delays)
        ]
        speeds = [positions.speed for positions in self._positions(delays, self.lag)]
        likelihood = np.empty((len(_JITTERS), len(_LOST)))
        latencies = np.empty_like(likelihood)
        for (i, jitter), (k, lost) in product(enumerate(_JITTERS), enumerate(_LOST)):
            candidate = delays.spread(jitter, lost, self._dt)
            latencies[i, k] = candidate.latency
            likelihood[i, k] = _PAIRS * pair_likelihood(errors, self._simulated(candidate, speeds))
            likelihood[i, k] -= lost / _USUAL_LOSS
            likelihood[i, k] += -np.inf if candidate.latency < -0.25 * self._dt else 0.0
        weights = np.exp(likelihood - likelihood.max())
        weights /= weights.sum()
        mean = float((weights * latencies).sum())
        error = float(np.sqrt((weights * (latencies - mean) ** 2).sum()))
        jitters = posterior(np.array(_JITTERS), weights.sum(axis=1))
        return jitters, posterior(np.array(_LOST), weights.sum(axis=0)), error

    def _simulated(self, delays: Delays, speeds: Sequence[Array]) -> list[Array]:
        """Return time errors of draws of the delays in each log, at given speeds, (draws, k)."""
        errors, latency = [], max(0.0, delays.latency)
        for log, at, speed in zip(self._logs, self._at, speeds, strict=True):
            targets, squared = log.targets[:, self._joints], _moving_square(speed)
            late = []
            for numbers in uniform_numbers(_DRAWS, len(targets)):
                drawn = drawn_delays(numbers, log.dt, latency, delays.jitter, delays.lost)
                active = drawn_commands(targets, *drawn)
                ends = moved_arm(active, log.dt, self.lag, log.arm_seconds)
                ends = np.concatenate([targets[:1], ends])
                positions = interpolated_columns(at, np.arange(float(len(ends))), ends)
                late.append(-np.sum(positions * speed, axis=1) / squared)
            errors.append(np.array(late))
        return errors


def _moving_square(speed: Array) -> Array:
    """Return squared speeds of arms, shape (k, w) -> (k,), NaN for those at rest or slow."""
    square = np.sum(speed**2, axis=1)
    least = max(MOVES**2, _FAST * float(square.max()))
    return np.where(square > least, square, np.nan)


def pair_likelihood(logs: Sequence[TimeErrors], drawn: Sequence[Array]) -> float:
    """Return the log-likelihood of all pairs of time errors a few measurements apart.

    Time errors are taken as Gaussian, as sums of the noise of positions and of delays. Those
    `drawn` for each log, shape (draws, k), give the variance and covariance of the delays.
    """
    # One variance for all times: it hardly depends on the speed, and few draws give noisy ones.
    variance = np.nanmean(np.concatenate([each.var(axis=0, ddof=1) for each in drawn])) + 1e-7
    normal = [(each - each.mean(axis=0)) / np.sqrt(variance) for each in drawn]
    total = 0.0
    for lag, shared in enumerate(zip(*(log.shared for log in logs), strict=True), start=1):
        products = [each[:, lag:] * each[:, :-lag] for each in normal]
        covariance = float(np.nanmean(np.concatenate(products, axis=1))) * variance
        total += sum(
            _pairs(log.late, variance + log.noise, covariance + noise, lag)
            for log, noise in zip(logs, shared, strict=True)
        )
    return total


def _pairs(late: Array, variance: Array, covariance: Array, lag: int) -> float:
    """Return the log-likelihood of pairs of Gaussian time errors, (k,), with a `lag` between them.

    The covariance has the shape (k - lag,). Outliers are clipped.
    """
    first, second, a, b = variance[:-lag], variance[lag:], late[:-lag], late[lag:]
    determinant = np.maximum(first * second - covariance**2, 1e-3 * first * second)
    square = (second * a**2 - 2.0 * covariance * a * b + first * b**2) / determinant
    return float(-0.5 * np.nansum(np.log(determinant) + np.minimum(square, 40.0)))
