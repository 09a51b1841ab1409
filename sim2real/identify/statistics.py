"""Estimates and their errors: statistics of fits, noise beside the predicted motion, and ages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify.log import Log
from kinfeas.sim2real.identify.model import Track

DRIVE = "drive the pattern of `kinfeas identify --drive`"
"""End of the sentences of `missing`, on what records do not show."""

NORMAL = 1.96
"""Half of a 95 % interval, in standard deviations."""

BLOCK = 2.0
"""Length in seconds of the blocks in which residuals may depend on each other."""

MOVES = 0.02
"""What counts as motion: m/s and rad/s, or m and rad of a joint."""

SLACK_SECONDS, SLACK, SLACK_JERK, SLACK_JOINTS = 0.008, 0.03, 0.4, 0.15
"""Least half-width of intervals: of times in seconds, of other numbers as a fraction.

Those of jerk and of the noise of joints are large, since a link smooths both before the record.
"""

_STEP = 0.02  # of parameters, for central differences
_FLAT = 1e-9  # squared derivative below which no residual depends on a parameter

Flags = NDArray[np.bool_]

_JUMP, _LEAST_JUMP = 4.5, 0.004  # least size of a jump: in standard deviations, and in m or rad
_LATE = 0.01  # s by which the time of a measurement may be off
_LEAST_VELOCITY = 1e-3  # m/s and rad/s, least noise of the base in fits
_ROUNDING = 1e-7  # rad and m, of the numbers of a record
_LEAST_POSITION = 1e-4  # rad and m, least noise of joint positions in fits
_CHANGES = 0.03  # m/s and rad/s in 0.2 s that count as acceleration
_ENOUGH, _MORE = 200, 1.4  # measurements that a variance needs, and its ratio to rest that counts
_GAP = 0.5  # s between measurements, beyond which a base may have moved on its own
_NEIGHBOURS = 2  # measurements before and after one whose noise may be correlated with its own
_ARM_SETTLES = 0.8  # s of constant targets after which the arm is at rest


@dataclass(frozen=True)
class Estimate:
    """An estimate and its 95 % interval, in SI units."""

    value: float
    low: float
    high: float


def time_estimate(value: float, error: float) -> Estimate:
    """Return the estimate of a time with a standard error, seconds."""
    half = NORMAL * error + SLACK_SECONDS
    return Estimate(value, max(0.0, value - half), value + half)


def lag_estimate(value: float, error: float, dt: float) -> Estimate:
    """Return the estimate of a time constant with a standard error, seconds.

    Time constants below half a period cannot be distinguished from zero.
    """
    if value < 0.5 * dt:
        return Estimate(value, 0.0, 0.5 * dt)
    return time_estimate(value, error)


def posterior(values: Array, weights: Array) -> Estimate:
    """Return mean and interval of a distribution on a grid, at least as wide as its cells."""
    mean = float(weights @ values)
    cumulated = np.concatenate([[0.0], np.cumsum(weights)])
    edges = np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])
    low, high = np.interp([0.025, 0.975], cumulated, edges)
    if weights[0] > 0.025:
        low = values[0]
    return Estimate(mean, float(low), float(high))


def time_blocks(times: Sequence[Array]) -> NDArray[np.intp]:
    """Return the indices of the blocks of `BLOCK` seconds that times of several logs are in."""
    blocks = [np.floor(seconds / BLOCK).astype(np.intp) for seconds in times]
    firsts = np.cumsum([0, *(block.max() + 1 for block in blocks[:-1])])
    return np.concatenate([block + first for block, first in zip(blocks, firsts, strict=True)])


def standard_errors(residuals: Array, derivatives: Array, blocks: NDArray[np.intp]) -> Array:
    """Return standard errors of parameters, shape (p,), for residuals correlated within blocks.

    Residuals, (r,), are normalised; derivatives are theirs, (r, p), blocks their indices, (r,).
    Of the estimators for independent residuals and for clusters (sandwich), the larger error
    counts. Errors are infinite for parameters on which no residual depends.
    """
    information = derivatives.T @ derivatives
    inverse = np.linalg.pinv(information)
    scores = np.zeros((int(blocks.max()) + 1, derivatives.shape[1]))
    np.add.at(scores, blocks, derivatives * np.clip(residuals, -5.0, 5.0)[:, np.newaxis])
    robust = inverse @ (scores.T @ scores) @ inverse
    variance = np.maximum(np.diag(robust), np.diag(inverse))
    return np.sqrt(np.where(np.diag(information) > _FLAT, variance, np.inf))


def derivatives(function: Callable[[Array], Array], z: Array) -> Array:
    """Return the derivatives, shape (r, p), of a function by parameters `z`, shape (p,)."""
    steps = _STEP * np.eye(len(z))
    columns = [(function(z + step) - function(z - step)) / (2.0 * _STEP) for step in steps]
    return np.stack(columns, axis=1)


def spread_of(residuals: Array) -> Array:
    """Return robust standard deviations of columns, (k, w) -> (w,), m/s or rad/s."""
    return np.maximum(1.4826 * np.median(np.abs(residuals), axis=0), _LEAST_VELOCITY)


def jumps(residuals: Array, deviation: Array, speed: Array) -> Flags:
    """Return which residuals of displacements, (k, 3), have a jump, shape (k,).

    Standard deviations and predicted speeds have the shape (k, 3), too. Measurement times that are
    off by some milliseconds make no jump.
    """
    least = np.maximum(_JUMP * deviation, _LEAST_JUMP + _LATE * np.abs(speed))
    return np.max(np.abs(residuals) / least, axis=1) > 1.0


def widened(flags: Flags) -> Flags:
    """Return the flags and their neighbours: an interpolated jump is in two displacements."""
    wide = flags.copy()
    wide[1:] |= flags[:-1]
    wide[:-1] |= flags[1:]
    return wide


def joint_noise(logs: Sequence[Log], at: Sequence[Array]) -> tuple[Estimate | None, float, bool]:
    """Return the noise of joint positions, their variance in fits, and whether `overlap` scales it.

    It does if measurements are interpolated between periods; `at` are their times in periods. If
    the arm is never at rest, the noise is None and the variance a guess.
    """
    parts, overlaps = [], []
    for log, moments in zip(logs, at, strict=True):
        settled = round(_ARM_SETTLES / log.dt)
        still = np.concatenate([[True], (np.diff(log.targets, axis=0) == 0.0).all(axis=1)])
        count = np.cumsum(still)
        last = np.minimum(moments.astype(np.intp), len(still) - 1)
        first = np.maximum(last - settled, 0)
        quiet = count[last] - count[first] >= last - first
        begins = np.flatnonzero(np.diff(quiet, prepend=False) & quiet)
        ends = np.flatnonzero(np.diff(quiet, append=False) & quiet) + 1
        for begin, end in zip(begins, ends, strict=True):
            if end - begin > 10:
                part = log.joints[begin:end]
                parts.append((part - part.mean(axis=0)) * np.sqrt(len(part) / (len(part) - 1.0)))
                overlaps.append(overlap(moments[begin:end]))
    if not parts:
        steps = np.concatenate([np.diff(log.joints, n=2, axis=0) for log in logs])
        guess = float(np.median(np.abs(steps)) / 0.6745 / np.sqrt(6.0)) + 1e-6
        return None, guess**2, False
    residuals, scale = np.concatenate(parts), np.concatenate(overlaps)
    variance, interpolated = _variance(residuals, scale, np.ones(len(scale)))
    noise, samples = variance, residuals.size
    if not interpolated:
        noise = _long_run(residuals, np.ones(len(residuals), dtype=np.bool_))
        samples = round(samples / (1.0 + 2.0 * _NEIGHBOURS))
    noise = noise if noise > _ROUNDING**2 else 0.0
    value = float(np.sqrt(noise))
    margin = NORMAL / np.sqrt(2.0 * samples / 1.6) + SLACK_JOINTS
    deviation = Estimate(value, value * (1.0 - margin), value * (1.0 + margin))
    return deviation, variance + _LEAST_POSITION**2, interpolated


def overlap(at: Array, lag: int = 0) -> Array:
    """Return the covariances of interpolated values `lag` entries apart, (k,) -> (k - lag,).

    `at` are ascending positions between independent values of variance 1 at 0, 1, 2 and so on.
    """
    first, second = at[: len(at) - lag], at[lag:]
    apart = np.floor(second) - np.floor(first)
    f, g = np.mod(first, 1.0), np.mod(second, 1.0)
    same = (1.0 - f) * (1.0 - g) + f * g
    return np.where(apart == 0.0, same, np.where(apart == 1.0, f * (1.0 - g), 0.0))


def _variance(residuals: Array, first: Array, second: Array) -> tuple[float, bool]:
    """Return the variance of Gaussian residuals, (k, w), in units of `first` or `second`, (k,).

    The unit is the more likely one; also returned is whether that is `first`.
    """
    squared = np.mean(residuals**2, axis=1)
    variances = [float(np.mean(squared / shape)) for shape in (first, second)]
    costs = [
        np.log(max(variance, 1e-300)) + float(np.mean(np.log(shape)))
        for variance, shape in zip(variances, (first, second), strict=True)
    ]
    best = int(np.argmin(costs))
    return variances[best], best == 0


def base_noise(
    tracks: Sequence[Track], velocities: Sequence[Array], walk: Sequence[float], missing: list[str]
) -> dict[str, Estimate]:
    """Return the noise of the base, and drift and jumps of its localisation.

    `velocities` are predicted, (n, 3) for each track. `walk` is the standard deviation of the drift
    after 1 s, metres and radians.
    """
    dt = tracks[0].log.dt
    predicted = [track.predicted(v) for track, v in zip(tracks, velocities, strict=True)]
    parts = [track.moved - p for track, p in zip(tracks, predicted, strict=True)]
    residuals = np.concatenate(parts)
    shape = np.concatenate([track.squares for track in tracks])
    constant = np.concatenate([track.seconds * dt for track in tracks])
    quiet = np.concatenate([_quiet(track, v) for track, v in zip(tracks, velocities, strict=True)])
    scale = np.sqrt(shape)[:, np.newaxis]
    seconds = np.concatenate([track.seconds for track in tracks])[:, np.newaxis]
    speed = np.concatenate(predicted) / seconds
    jump = jumps(residuals, scale * spread_of(residuals / scale), speed)
    used = ~widened(jump) & quiet
    estimates: dict[str, Estimate] = {}
    if used.sum() < 50:
        missing.append(f"no time at constant velocity: noise of the base unknown; {DRIVE}")
        return estimates
    used = _calmest(residuals, shape, used, np.abs(speed).max(axis=1) < _CHANGES)
    drifts = []
    for name, axes, drift in (("linear", [0, 1], walk[0]), ("angular", [2], walk[1])):
        variance, in_periods = _variance(residuals[used][:, axes], shape[used], constant[used])
        shared = 1.6  # neighbours share a period
        if not in_periods:
            variance = _long_run(residuals[:, axes] / np.sqrt(constant)[:, np.newaxis], used)
            shared = 1.0 + 2.0 * _NEIGHBOURS
        count = len(axes) * used.sum() / shared
        error = variance * (np.sqrt(2.0 / count) + SLACK / 2.0)
        drift_variance = min(drift**2 / dt, variance)
        value, low, high = (
            float(np.sqrt(max(0.0, each - drift_variance)))
            for each in (variance, variance - NORMAL * error, variance + NORMAL * error)
        )
        estimates[f"base_noise.{name}"] = Estimate(value, low, high)
        drifts.append(float(np.sqrt(drift_variance * dt)))
    for name, drift in zip(("drift", "turn_drift"), drifts, strict=True):
        estimates[f"localisation.{name}"] = Estimate(drift, drift, drift)
    missing.append(
        "noise of the base and drift of its localisation look alike: a drift of "
        f"{drifts[0]:.3g} m and {drifts[1]:.3g} rad after 1 s is assumed"
    )
    return estimates | _localisation_jumps(tracks, parts, jump & (seconds[:, 0] < _GAP), drifts)


def _long_run(residuals: Array, used: Flags) -> float:
    """Return the long-run variance of residuals, shape (k, w), with correlated neighbours.

    Neighbours are correlated if the base or a filter smooths its noise, in periods of its own.
    """
    variance = float(np.mean(residuals[used] ** 2))
    for lag in range(1, _NEIGHBOURS + 1):
        both = used[lag:] & used[:-lag]
        variance += 2.0 * float(np.mean((residuals[lag:] * residuals[:-lag])[both]))
    return max(variance, 0.0)


def _calmest(residuals: Array, shape: Array, used: Flags, still: Flags) -> Flags:
    """Return which residuals to use, (k,): only those of a base at rest if motion adds to them.

    Motion adds to them if the times of measurements are off.
    """
    both = [used & still, used & ~still]
    if min(flags.sum() for flags in both) < _ENOUGH:
        return used
    calm, moving = (np.mean(residuals[f] ** 2 / shape[f][:, np.newaxis], axis=0) for f in both)
    return both[0] if np.any(moving > _MORE * calm) else used


def _quiet(track: Track, velocities: Array) -> Flags:
    """Return whether the predicted velocity is constant around each displacement, shape (k,)."""
    period = np.minimum((track.times / track.log.dt).astype(np.intp), len(velocities) - 1)
    wide = max(1, round(0.1 / track.log.dt))
    padded = np.pad(velocities, ((wide, wide), (0, 0)), mode="edge")
    change = np.abs(padded[2 * wide :] - padded[: -2 * wide]).max(axis=1)
    return change[period] < _CHANGES


def _localisation_jumps(
    tracks: Sequence[Track], parts: Sequence[Array], jump: Flags, drifts: Sequence[float]
) -> dict[str, Estimate]:
    """Return rate and sizes of jumps; each draws a new error, and a track begins without error."""
    seconds = sum(len(track.log.twists) * track.log.dt for track in tracks)
    sums, walked, count, first_jumps = np.zeros(3), np.zeros(3), 0, 0
    ends = np.cumsum([len(residuals) for residuals in parts])[:-1]
    for track, residuals, flags in zip(tracks, parts, np.split(jump, ends), strict=True):
        starts = np.flatnonzero(flags & ~np.concatenate([[False], flags[:-1]]))
        last = 0.0
        for start in starts:
            # An interpolated jump lies in several displacements.
            end = start + int(np.argmin(np.append(flags[start:], False)))
            sums += residuals[max(0, start - 1) : end + 1].sum(axis=0) ** 2
            walked += (track.times[start] - last) * np.array([drifts[0], drifts[0], drifts[1]]) ** 2
            last = float(track.times[start])
        count, first_jumps = count + len(starts), first_jumps + bool(len(starts))
    if not count:
        keys = "localisation.jump", "localisation.turn_jump", "localisation.rate"
        return dict.fromkeys(keys, Estimate(0.0, 0.0, 0.0))
    low = chi2.ppf(0.025, 2.0 * count) / 2.0 / seconds
    high = chi2.ppf(0.975, 2.0 * count + 2.0) / 2.0 / seconds
    rate = Estimate(count / seconds, float(low), float(high))
    # A jump is the difference of two errors, but the first one of a track has only one.
    variances = np.maximum(sums - walked, 0.05 * sums) / (2.0 * count - first_jumps)
    sizes = {"jump": (float(variances[:2].mean()), 2.0), "turn_jump": (float(variances[2]), 1.0)}
    estimates = {}
    for name, (variance, axes) in sizes.items():
        degrees = max(1.0, count * axes / 2.0)
        interval: Array = np.sqrt(variance * degrees / chi2.ppf([0.975, 0.025], degrees))
        estimates[f"localisation.{name}"] = Estimate(float(np.sqrt(variance)), *interval.tolist())
    return {**estimates, "localisation.rate": rate}


def sensor_ages(logs: Sequence[Log], missing: list[str]) -> dict[str, Estimate]:
    """Return the latency of measurements, from their ages."""
    ages = np.concatenate([log.ages for log in logs])
    if len(ages) < 20 or not np.any(ages > 1e-4):
        missing.append("no ages of measurements: a sensor latency counts as command latency")
        return {}
    low, high = np.quantile(ages, [0.05, 0.95])
    width = float(high - low) / 0.9
    begin = max(0.0, float(low) - 0.05 * width)
    slack = 0.5 * SLACK_SECONDS + 0.02 * width
    return {
        "sensor_latency.seconds": Estimate(begin, max(0.0, begin - slack), begin + slack),
        "sensor_latency.jitter": Estimate(width, max(0.0, width - 2 * slack), width + 2 * slack),
    }
