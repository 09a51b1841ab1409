"""The fit of a robot's response and noise to logs of its commands and measurements.

The chain of `kinfeas.sim2real.identify.chain` is carried out for the recorded commands. Compared
are the ways of the base between two measurements, and the positions of the arm. Each log also gives
the noise that remains. Intervals are of 95 % and treat blocks of two seconds as independent.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify import chain
from kinfeas.sim2real.identify.log import Log

Flags = NDArray[np.bool_]

DRIVE = "drive the pattern of `kinfeas identify --drive`"

_NORMAL = 1.96  # half of a 95 % interval in standard deviations
_STEP = 0.02  # for derivatives, of the parameters below
_LATENCY = 0.05  # s, the unit of a latency; the other parameters are logarithms
_BLOCK = 2.0  # s of residuals that depend on each other
_SHOWN = 4.0  # improvement of half the sum of squares by a limit that a record shows
_JUMP = 4.5  # standard deviations of a jump
_MOVES = 0.02  # m/s and rad/s, or m and rad of a joint, that count as motion
_CHANGES = 0.03  # m/s and rad/s in 0.2 s that count as acceleration
_ARM_SETTLES = 0.8  # s of constant targets after which the arm is at rest
_DRAWS = 16  # of delays, for the spread that jitter and lost commands cause
_BASE_DRAWS = 8  # the same, for their mean effect on the base
_JITTERS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1)
_LOST = (0.0, 0.01, 0.025, 0.05, 0.075, 0.1, 0.13, 0.17)
_PAIRS = 0.1  # weight of the likelihood of pairs, each of which is in six and depends on others
_SYSTEMATIC = 0.003  # s, at least, of the half of an interval of times
_SLACK = 0.03  # the same of limits and noise, as a fraction
_TIMES, _LIMITS = np.log([1e-3, 3.0]), np.log([0.05, 50.0])
_JERKS = np.log([0.5, 300.0])


@dataclass(frozen=True)
class Estimate:
    """An estimate and its 95 % interval, in SI units."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Walk:
    """Random walk of a localisation: standard deviation after 1 s, metres and radians."""

    drift: float
    turn_drift: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted robot.

    Attributes:
        estimates: By adapter and parameter, such as `actuator_lag.base`; those that are known.
        response: Response of the robot; without what the logs do not show.
        missing: What they do not show, in sentences.
        times: Times of measured velocities, seconds, shape (k,) for each log.
        measured: Measured velocities of the base in world axes, shape (k, 3), m/s and rad/s.
        predicted: Velocities that the fitted robot has.
    """

    estimates: dict[str, Estimate]
    response: ResponseModel
    missing: tuple[str, ...]
    times: tuple[Array, ...]
    measured: tuple[Array, ...]
    predicted: tuple[Array, ...]


def fit(logs: Sequence[Log], walk: Walk) -> Fit:
    """Return the robot of some logs with equal control periods.

    The measured base pose is a random walk, of noise on the base and of its localisation. Both look
    alike: the part `walk` is taken as known.
    """
    dt, found, missing = logs[0].dt, dict[str, Estimate](), list[str]()
    arm, ways = _ArmProblem(logs), [_Ways(log) for log in logs]
    delays, error = arm.fit() if arm.moves else (None, np.inf)
    base = _BaseProblem(ways, dt)
    model, errors = base.fit(delays, error)
    latency = errors.get("latency", error) if base.moves else error
    if delays is not None and base.moves and model.delays is not delays:
        arm.fit_lag(model.delays)
    delays = model.delays if base.moves else delays
    if delays is None:
        missing.append(f"nothing moves: command latency, lags and limits unknown; {DRIVE}")
    else:
        spread = arm.spread(delays) if arm.moves else None
        found |= _delays(delays, latency, spread, dt)
    found |= _limits(model, errors, base, missing)
    if arm.moves:
        found["actuator_lag.arm"] = _time(arm.lag, arm.error)
        if arm.noise is not None:
            found["joint_noise.deviation"] = arm.noise
    elif delays is not None:
        missing.append(f"no arm motion: arm lag and lost commands unknown; {DRIVE}")
    if "joint_noise.deviation" not in found:
        missing.append(f"the arm is never at rest: joint noise unknown; {DRIVE}")
    found |= _base_noise(ways, [model.velocities(way.log, _BASE_DRAWS) for way in ways], walk, missing)
    found |= _ages(logs, missing)
    return _result(ways, model, found, missing, None if delays is None else delays.mean(dt))


@dataclass(frozen=True)
class _Delays:
    """Delays of commands: the shortest, seconds, their jitter, and the probability of a loss."""

    latency: float
    jitter: float = 0.02
    lost: float = 0.02

    def weights(self, dt: float) -> Array:
        return chain.delay_weights(self.latency, self.jitter, self.lost, dt)

    def mean(self, dt: float) -> float:
        return chain.mean_delay(self.weights(dt), dt)

    def spread(self, jitter: float, lost: float, dt: float) -> "_Delays":
        """Return delays with the same mean."""
        other = _Delays(self.latency, jitter, lost)
        return replace(other, latency=self.latency + self.mean(dt) - other.mean(dt))


@dataclass(frozen=True)
class _Model:
    """Response of a base: delays, lag, and limits (2,) of translation and rotation."""

    delays: _Delays
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
        return chain.mean_moved_base(log.twists, log.dt, *delays, *limits, draws)


class _Ways:
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
        self._kept = np.diff(self._at) > 1e-3
        self.moved = np.diff(log.base, axis=0)[self._kept]
        begin, end = self._at[:-1][self._kept], self._at[1:][self._kept]
        self.seconds, self.times = (end - begin) * log.dt, 0.5 * (begin + end) * log.dt
        squares, first = np.zeros(len(begin)), np.floor(begin)
        for k in range(int(np.ceil((end - begin).max())) + 2):
            overlap = np.minimum(end, first + k + 1.0) - np.maximum(begin, first + k)
            squares += np.clip(overlap, 0.0, None) ** 2
        self.squares: Array = squares * log.dt**2

    def predicted(self, velocities: Array) -> Array:
        """Return the ways at a velocity for each period, shape (n, 3)."""
        way = np.concatenate([np.zeros((1, 3)), np.cumsum(velocities, axis=0) * self.log.dt])
        at = _interpolated(way, self._at)
        return np.diff(at, axis=0)[self._kept]


class _BaseProblem:
    """The fit of a base's response to its ways."""

    def __init__(self, ways: Sequence[_Ways], dt: float) -> None:
        self._ways, self._dt = ways, dt
        fastest = np.max([np.abs(way.log.twists).max(axis=0) for way in ways], axis=0)
        self.moves = bool((fastest > _MOVES).any())
        self.parts = np.array([fastest[:2].max() > _MOVES, fastest[2] > _MOVES])
        self._scale = [np.sqrt(way.squares)[:, np.newaxis] for way in ways]
        self._kept = [np.ones(len(way.moved), dtype=np.bool_) for way in ways]
        self._deviation = np.ones(3)
        blocks = [np.floor(way.times / _BLOCK).astype(np.intp) for way in ways]
        ends = np.cumsum([0, *(block.max() + 1 for block in blocks)])
        self._blocks = [block + end for block, end in zip(blocks, ends[:-1], strict=True)]

    def fit(self, arm: _Delays | None, error: float) -> tuple[_Model, dict[str, float]]:
        """Return the model and the standard errors of its parameters, relative but for times.

        Args:
            arm: Delays that the arm shows.
            error: Standard error of their latency, seconds.
        """
        none = np.full(2, np.inf)
        model = _Model(arm or _Delays(0.0), 0.0, none, none)
        if not self.moves:
            return model, {}
        names = ["lag", *(f"{kind}.{part}" for part in np.flatnonzero(self.parts)
                          for kind in ("acceleration", "jerk"))]  # fmt: skip
        free = ["latency", *names]
        self._normalise(model)
        latencies = (0.03, 0.1, 0.2) if arm is None else (arm.latency,)
        best, least = model, np.inf
        for latency, lag, limit in product(latencies, (0.03, 0.1, 0.3), (0.4, 1.0, 2.5)):
            delays = replace(model.delays, latency=latency)
            limits = np.where(self.parts, limit, np.inf), np.where(self.parts, 10.0, np.inf)
            tried, cost = self._solve(_Model(delays, lag, *limits), names, "soft_l1")
            if cost < least:
                best, least = tried, cost
        self._draws = _BASE_DRAWS
        for _ in range(2):
            self._normalise(best)
            best, least = self._solve(best, free, "linear")
        if arm is not None:
            errors = self._errors(best, free)
            apart = abs(best.delays.latency - arm.latency)
            if apart <= max(0.015, 3.0 * np.hypot(errors["latency"], error)):
                self._prior = arm.latency, max(error, 0.001)
                best, least = self._solve(best, free, "linear")
        for name in [name for name in names if "." in name]:
            # Jerk first: without it, the acceleration may still be shown.
            kind, part = name.split(".")
            field = {"jerk": "jerk", "acceleration": "acceleration"}[kind]
            limits = getattr(best, field).copy()
            limits[int(part)] = np.inf
            fewer = [other for other in free if other != name]
            without, cost = self._solve(replace(best, **{field: limits}), fewer, "linear")
            if cost - least < _SHOWN:
                best, least, free = without, cost, fewer
        return best, self._errors(best, free)

    _prior: tuple[float, float] | None = None  # latency and its standard error
    _draws = 0  # of delays

    def _normalise(self, model: _Model) -> None:
        """Estimate the noise of each axis, and leave out jumps."""
        rests = [
            (way.predicted(model.velocities(way.log, self._draws)) - way.moved) / scale
            for way, scale in zip(self._ways, self._scale, strict=True)
        ]
        self._deviation = 1.4826 * np.median(np.abs(np.concatenate(rests)), axis=0) + 1e-9
        self._kept = [~_near(jumps(rest / self._deviation)) for rest in rests]

    def _residuals(self, model: _Model) -> Array:
        parts = []
        for way, scale, kept in zip(self._ways, self._scale, self._kept, strict=True):
            rest = way.predicted(model.velocities(way.log, self._draws)) - way.moved
            parts.append((rest / (scale * self._deviation) * kept[:, np.newaxis]).ravel())
        if self._prior is not None:
            latency, error = self._prior
            parts.append(np.array([(model.delays.latency - latency) / error]))
        return np.concatenate(parts)

    def _solve(self, model: _Model, free: Sequence[str], loss: str) -> tuple[_Model, float]:
        bounds = np.array([_bounds(name) for name in free])
        start = np.clip([_get(model, name) for name in free], *(bounds.T + [[1e-6], [-1e-6]]))

        def residuals(z: Array) -> Array:
            return self._residuals(_changed(model, free, z))

        found = least_squares(
            residuals, start, jac=lambda z: _derivatives(residuals, z), bounds=bounds.T,
            loss=loss, f_scale=3.0, max_nfev=20, xtol=1e-3, ftol=1e-6,
        )  # fmt: skip
        return _changed(model, free, found.x), float(found.cost)

    def _errors(self, model: _Model, free: Sequence[str]) -> dict[str, float]:
        z = np.array([_get(model, name) for name in free])

        def residuals(z: Array) -> Array:
            return self._residuals(_changed(model, free, z))

        blocks = np.concatenate([np.repeat(block, 3) for block in self._blocks])
        if self._prior is not None:
            blocks = np.append(blocks, blocks.max() + 1)
        errors = standard_errors(residuals(z), _derivatives(residuals, z), blocks)
        errors = np.where([name == "latency" for name in free], errors * _LATENCY, errors)
        return dict(zip(free, errors.tolist(), strict=True))


class _ArmProblem:
    """The fit of an arm's lag and delays to its positions.

    Attributes:
        moves: Whether it moves at all.
        lag: Time constant, seconds.
        error: Its standard error.
        noise: Noise of its measured positions, if it is ever at rest.
    """

    def __init__(self, logs: Sequence[Log]) -> None:
        self._logs, self._dt = logs, logs[0].dt
        ranges = np.max([np.ptp(log.targets, axis=0) for log in logs], axis=0)
        self._joints = ranges > _MOVES
        self.moves = bool(self._joints.any())
        self.lag, self.error = 0.02, np.inf
        self._at = [np.clip(log.joint_times / log.dt, 0, len(log.targets)) for log in logs]
        self.noise, self._variances = _joint_noise(logs, self._at)
        self._spread = 0.0  # s, of the delays
        blocks = [np.floor(log.joint_times / _BLOCK).astype(np.intp) for log in logs]
        ends = np.cumsum([0, *(block.max() + 1 for block in blocks)])
        self._blocks = np.concatenate([b + end for b, end in zip(blocks, ends[:-1], strict=True)])

    def fit(self) -> tuple[_Delays, float]:
        """Return the delays and the standard error of the latency, seconds."""
        delays = _Delays(0.05)
        for _ in range(2):
            delays, errors = self._solve(delays, latency=True)
            jitter, lost, _ = self.spread(delays)
            delays = delays.spread(jitter.value, lost.value, self._dt)
        delays, errors = self._solve(delays, latency=True)
        return delays, errors

    def fit_lag(self, delays: _Delays) -> None:
        """Fit the lag for given delays."""
        self._solve(delays, latency=False)

    def _solve(self, delays: _Delays, *, latency: bool) -> tuple[_Delays, float]:
        def residuals(z: Array) -> Array:
            shifted = replace(delays, latency=z[1] * _LATENCY) if latency else delays
            return self._residuals(shifted, float(np.exp(z[0])))

        start = np.array([np.log(self.lag), max(delays.latency, 1e-3) / _LATENCY])
        bounds = np.array([_TIMES, _bounds("latency")])
        start, bounds = (start, bounds) if latency else (start[:1], bounds[:1])
        for _ in range(2):
            found = least_squares(
                residuals, start, jac=lambda z: _derivatives(residuals, z), bounds=bounds.T,
                loss="soft_l1", f_scale=3.0, max_nfev=40, xtol=1e-5,
            )  # fmt: skip
            start, self.lag = found.x, float(np.exp(found.x[0]))
            if latency:
                delays = replace(delays, latency=float(found.x[1]) * _LATENCY)
            late, variance = self._time_errors(delays)
            weights = 1.0 / (variance + self._spread**2)
            spread = np.nansum((late**2 - variance) * weights) / np.nansum(weights)
            self._spread = float(np.sqrt(max(0.0, spread)))
        blocks = np.repeat(self._blocks, int(self._joints.sum()))
        errors = standard_errors(residuals(start), _derivatives(residuals, start), blocks)
        self.error = float(errors[0]) * self.lag
        return delays, float(errors[1]) * _LATENCY if latency else 0.0

    def _positions(self, delays: _Delays, lag: float) -> Iterator[tuple[Array, Array, Array]]:
        """Yield predicted and measured positions, and speeds, shape (k, moving) each."""
        for log, at in zip(self._logs, self._at, strict=True):
            targets = log.targets[:, self._joints]
            ends = chain.moved_arm(chain.delayed(targets, delays.weights(log.dt)), log.dt, lag)
            ends = np.concatenate([targets[:1], ends])
            predicted, measured = _interpolated(ends, at), log.joints[:, self._joints]
            offset = np.median(measured - predicted, axis=0)
            yield predicted + offset, measured, _interpolated(np.gradient(ends, log.dt, axis=0), at)

    def _residuals(self, delays: _Delays, lag: float) -> Array:
        parts = [
            (p - m) / np.sqrt(variance[:, np.newaxis] + (self._spread * s) ** 2)
            for (p, m, s), variance in zip(
                self._positions(delays, lag), self._variances, strict=True
            )
        ]
        return np.concatenate(parts).ravel()

    def _time_errors(self, delays: _Delays) -> tuple[Array, Array]:
        """Return by how much the arm is late, seconds, and the noise's variance of that, (k,).

        NaN where it does not move.
        """
        late, variances = [], []
        for (p, m, s), variance in zip(
            self._positions(delays, self.lag), self._variances, strict=True
        ):
            square = _moving_square(s)
            late.append(np.sum((p - m) * s, axis=1) / square)
            variances.append(variance / square)
        return np.concatenate(late), np.concatenate(variances)

    def spread(self, delays: _Delays) -> tuple[Estimate, Estimate, float]:
        """Return the jitter, the probability of a loss, and an error of the latency from both.

        Time errors of the arm are compared with those of simulated delays, by the likelihood of
        pairs of neighbours.
        """
        late, noise = self._time_errors(delays)
        speeds = [speed for _, _, speed in self._positions(delays, self.lag)]
        likelihood = np.empty((len(_JITTERS), len(_LOST)))
        latencies = np.empty_like(likelihood)
        for (i, jitter), (k, lost) in product(enumerate(_JITTERS), enumerate(_LOST)):
            tried = delays.spread(jitter, lost, self._dt)
            latencies[i, k] = tried.latency
            drawn = self._simulated(tried, speeds)
            variance = drawn.var(axis=0, ddof=1) + 1e-8
            normal = (drawn - drawn.mean(axis=0)) / np.sqrt(variance)
            likelihood[i, k] = _PAIRS * sum(
                _pairs(late, variance, noise, float(np.nanmean(normal[:, lag:] * normal[:, :-lag])),
                       lag)
                for lag in (1, 2, 3)
            )  # fmt: skip
            likelihood[i, k] += -np.inf if tried.latency < -0.25 * self._dt else 0.0
        weights = np.exp(likelihood - likelihood.max())
        weights /= weights.sum()
        mean = float((weights * latencies).sum())
        error = float(np.sqrt((weights * (latencies - mean) ** 2).sum()))
        return (
            _posterior(np.array(_JITTERS), weights.sum(axis=1)),
            _posterior(np.array(_LOST), weights.sum(axis=0)),
            error,
        )

    def _simulated(self, delays: _Delays, speeds: Sequence[Array]) -> Array:
        """Return time errors of draws of the delays, at given speeds, shape (draws, k)."""
        errors, latency = [], max(0.0, delays.latency)
        for log, at, speed in zip(self._logs, self._at, speeds, strict=True):
            targets, square = log.targets[:, self._joints], _moving_square(speed)
            late = []
            for seed in range(_DRAWS):
                mixed, kept = chain.drawn_delays(
                    len(targets), log.dt, latency, delays.jitter, delays.lost, seed
                )
                active = chain.drawn_commands(targets, mixed, kept)
                ends = chain.moved_arm(active, log.dt, self.lag)
                drawn = _interpolated(np.concatenate([targets[:1], ends]), at)
                late.append(-np.sum(drawn * speed, axis=1) / square)
            errors.append(late)
        return np.concatenate(errors, axis=1)


def _moving_square(speed: Array) -> Array:
    """Return squared speeds of arms, shape (k, w) -> (k,), NaN for those at rest."""
    square = np.sum(speed**2, axis=1)
    return np.where(square > _MOVES**2, square, np.nan)


def _pairs(late: Array, variance: Array, noise: Array, correlation: float, lag: int) -> float:
    """Return the log-likelihood of pairs of values, (k,), with a `lag` between them."""
    shared = correlation * np.sqrt(variance[lag:] * variance[:-lag])
    total = variance + noise
    first, second, a, b = total[:-lag], total[lag:], late[:-lag], late[lag:]
    determinant = first * second - shared**2
    square = (second * a**2 - 2.0 * shared * a * b + first * b**2) / determinant
    return float(-0.5 * np.nansum(np.log(determinant) + np.minimum(square, 40.0)))


def standard_errors(residuals: Array, derivatives: Array, blocks: NDArray[np.intp]) -> Array:
    """Return standard errors of parameters, shape (p,), for residuals that depend within blocks.

    Args:
        residuals: Normalised residuals, shape (r,).
        derivatives: Their derivatives, shape (r, p).
        blocks: Number of the block of each residual, shape (r,).
    """
    inverse = np.linalg.pinv(derivatives.T @ derivatives)
    scores = np.zeros((int(blocks.max()) + 1, derivatives.shape[1]))
    np.add.at(scores, blocks, derivatives * np.clip(residuals, -5.0, 5.0)[:, np.newaxis])
    robust = inverse @ (scores.T @ scores) @ inverse
    errors: Array = np.sqrt(np.maximum(np.diag(robust), np.diag(inverse)))
    return errors


def jumps(rest: Array) -> Flags:
    """Return which normalised rests of poses, shape (k, 3), are jumps, shape (k,)."""
    flags: Flags = (np.abs(rest) > _JUMP).any(axis=1)
    return flags


def _near(flags: Flags) -> Flags:
    """Return the flags and their neighbours: an interpolated jump is in two ways."""
    wide = flags.copy()
    wide[1:] |= flags[:-1]
    wide[:-1] |= flags[1:]
    return wide


def _joint_noise(logs: Sequence[Log], at: Sequence[Array]) -> tuple[Estimate | None, list[Array]]:
    """Return the noise of joint positions, and its variance for each of them, (k,) by log.

    Measurements that are interpolated between periods have less noise, if the rests say so.
    """
    rests, shares = [], []
    for log, moments in zip(logs, at, strict=True):
        settled = round(_ARM_SETTLES / log.dt)
        still = np.concatenate([[True], (np.diff(log.targets, axis=0) == 0.0).all(axis=1)])
        count = np.cumsum(still)
        last = np.minimum(moments.astype(np.intp), len(still) - 1)
        first = np.maximum(last - settled, 0)
        quiet = count[last] - count[first] >= last - first
        begins = np.flatnonzero(np.diff(quiet, prepend=False) & quiet)
        ends = np.flatnonzero(np.diff(quiet, append=False) & quiet) + 1
        fraction = np.mod(moments, 1.0)
        for begin, end in zip(begins, ends, strict=True):
            if end - begin > 10:
                part = log.joints[begin:end]
                rests.append((part - part.mean(axis=0)) * np.sqrt(len(part) / (len(part) - 1.0)))
                f = fraction[begin:end]
                shares.append((1.0 - f) ** 2 + f**2)
    if not rests:
        steps = np.concatenate([np.diff(log.joints, n=2, axis=0) for log in logs])
        guess = float(np.median(np.abs(steps)) / 0.6745 / np.sqrt(6.0)) + 1e-6
        return None, [np.full(len(moments), guess**2) for moments in at]
    rest, share = np.concatenate(rests), np.concatenate(shares)
    variance, interpolated = _variance(rest, share, np.ones(len(share)))
    noise = _deviation(variance, rest.size)
    fractions = [np.mod(moments, 1.0) for moments in at]
    return noise, [
        (variance + 1e-12) * ((1.0 - f) ** 2 + f**2 if interpolated else np.ones(len(f)))
        for f in fractions
    ]


def _variance(rest: Array, first: Array, second: Array) -> tuple[float, bool]:
    """Return the variance in units of that one of two shapes, (k,), that fits; whether it is first.

    `rest` has shape (k, w) and is Gaussian.
    """
    squared = np.mean(rest**2, axis=1)
    variances = [float(np.mean(squared / shape)) for shape in (first, second)]
    logs = [
        np.log(max(variance, 1e-300)) + float(np.mean(np.log(shape)))
        for variance, shape in zip(variances, (first, second), strict=True)
    ]
    best = int(np.argmin(logs))
    return variances[best], best == 0


def _base_noise(
    ways: Sequence[_Ways], velocities: Sequence[Array], walk: Walk, missing: list[str]
) -> dict[str, Estimate]:
    """Return the noise of the base, and drift and jumps of its localisation."""
    dt = ways[0].log.dt
    rests = [way.moved - way.predicted(v) for way, v in zip(ways, velocities, strict=True)]
    rest = np.concatenate(rests)
    shape = np.concatenate([way.squares for way in ways])
    constant = np.concatenate([way.seconds * dt for way in ways])
    quiet = np.concatenate([_quiet(way, v) for way, v in zip(ways, velocities, strict=True)])
    deviation = 1.4826 * np.median(np.abs(rest / np.sqrt(shape)[:, np.newaxis]), axis=0) + 1e-9
    jump = jumps(rest / (np.sqrt(shape)[:, np.newaxis] * deviation))
    used = ~_near(jump) & quiet
    found: dict[str, Estimate] = {}
    if used.sum() < 50:
        missing.append(f"no time at constant velocity: noise of the base unknown; {DRIVE}")
        return found
    drifts = []
    for name, axes, drift in (
        ("linear", [0, 1], walk.drift), ("angular", [2], walk.turn_drift)
    ):  # fmt: skip
        variance, _ = _variance(rest[used][:, axes], shape[used], constant[used])
        # Neighbours share a period.
        error = variance * np.sqrt(2.0 / (len(axes) * used.sum() / 1.6)) + _SLACK * variance / 2.0
        drift = min(drift, float(np.sqrt(variance * dt)))  # noqa: PLW2901
        known = drift**2 / dt
        value, low, high = (
            float(np.sqrt(max(0.0, each - known)))
            for each in (variance, variance - _NORMAL * error, variance + _NORMAL * error)
        )
        found[f"base_noise.{name}"] = Estimate(value, low, high)
        drifts.append(drift)
    for name, drift in zip(("drift", "turn_drift"), drifts, strict=True):
        found[f"localisation.{name}"] = Estimate(drift, drift, drift)
    missing.append(
        "noise of the base and drift of its localisation look alike: a drift of "
        f"{drifts[0]:.3g} m and {drifts[1]:.3g} rad after 1 s is assumed"
    )
    return found | _localisation_jumps(ways, rests, jump, drifts)


def _quiet(way: _Ways, velocities: Array) -> Flags:
    """Return in which ways the predicted velocity is constant, shape (k,)."""
    number = np.minimum((way.times / way.log.dt).astype(np.intp), len(velocities) - 1)
    wide = max(1, round(0.1 / way.log.dt))
    padded = np.pad(velocities, ((wide, wide), (0, 0)), mode="edge")
    change = np.abs(padded[2 * wide :] - padded[: -2 * wide]).max(axis=1)
    quiet: Flags = change[number] < _CHANGES
    return quiet


def _localisation_jumps(
    ways: Sequence[_Ways], rests: Sequence[Array], jump: Flags, drifts: Sequence[float]
) -> dict[str, Estimate]:
    """Return rate and size of jumps, each of which draws a new error, none at first."""
    seconds = sum(way.log.seconds for way in ways)
    sums, walked, count, first = np.zeros(3), np.zeros(3), 0, 0
    ends = np.cumsum([len(rest) for rest in rests])[:-1]
    for way, rest, flags in zip(ways, rests, np.split(jump, ends), strict=True):
        starts = np.flatnonzero(flags & ~np.concatenate([[False], flags[:-1]]))
        last = 0.0
        for start in starts:
            # An interpolated jump lies in several ways.
            end = start + int(np.argmin(np.append(flags[start:], False)))
            sums += rest[max(0, start - 1) : end + 1].sum(axis=0) ** 2
            walked += (way.times[start] - last) * np.array([*drifts[:1] * 2, drifts[1]]) ** 2
            last = float(way.times[start])
        count, first = count + len(starts), first + bool(len(starts))
    low, high = chi2.ppf([0.025, 0.975], [2.0 * max(count, 0.5), 2.0 * count + 2.0])
    low, high = low / 2.0 / seconds, high / 2.0 / seconds
    rate = Estimate(count / seconds, float(low) if count else 0.0, float(high))
    if not count:
        none = Estimate(0.0, 0.0, 0.0)
        return {"localisation.jump": none, "localisation.turn_jump": none,
                "localisation.rate": none}  # fmt: skip
    variances = np.maximum(sums - walked, 0.05 * sums) / (2.0 * count - first)
    sizes = {"jump": (float(variances[:2].mean()), 2.0), "turn_jump": (float(variances[2]), 1.0)}
    found = {}
    for name, (variance, axes) in sizes.items():
        degrees = max(1.0, count * axes / 2.0)
        ends_of = variance * degrees / chi2.ppf([0.975, 0.025], degrees)
        found[f"localisation.{name}"] = Estimate(
            float(np.sqrt(variance)), *np.sqrt(ends_of).tolist()
        )
    return {**found, "localisation.rate": rate}


def _ages(logs: Sequence[Log], missing: list[str]) -> dict[str, Estimate]:
    """Return the latency of measurements, from their ages."""
    ages = np.concatenate([log.ages for log in logs])
    if len(ages) < 20 or not np.any(ages > 1e-4):
        missing.append("no ages of measurements: a sensor latency counts as command latency")
        return {}
    low, high = np.quantile(ages, [0.05, 0.95])
    width = float(high - low) / 0.9
    begin = max(0.0, float(low) - 0.05 * width)
    slack = 0.5 * _SYSTEMATIC + 0.02 * width
    return {
        "sensor_latency.seconds": Estimate(begin, max(0.0, begin - slack), begin + slack),
        "sensor_latency.jitter": Estimate(width, max(0.0, width - 2 * slack), width + 2 * slack),
    }


def _delays(
    delays: _Delays, error: float, spread: tuple[Estimate, Estimate, float] | None, dt: float
) -> dict[str, Estimate]:
    if spread is None:
        half = _NORMAL * error + _SYSTEMATIC
        mean = delays.mean(dt)
        return {"command_latency.seconds": Estimate(mean, max(0.0, mean - half), mean + half)}
    jitter, lost, more = spread
    half = _NORMAL * float(np.hypot(error, more)) + _SYSTEMATIC
    value = max(0.0, delays.spread(jitter.value, lost.value, dt).latency)
    return {
        "dropped_commands.probability": lost,
        "command_latency.seconds": Estimate(value, max(0.0, value - half), value + half),
        "command_latency.jitter": jitter,
    }


def _limits(
    model: _Model, errors: dict[str, float], base: _BaseProblem, missing: list[str]
) -> dict[str, Estimate]:
    found: dict[str, Estimate] = {}
    if not base.moves:
        missing.append(f"the base does not move: its lag and limits are unknown; {DRIVE}")
        return found
    if errors["lag"] * model.lag < 0.1:
        found["actuator_lag.base"] = _time(model.lag, errors["lag"] * model.lag)
    else:
        missing.append(f"no fast change of the base's velocity: its lag is unknown; {DRIVE}")
    for part, name, motion in ((0, "linear", "start or stop"), (1, "angular", "turn")):
        for kind, key in (("acceleration", name), ("jerk", f"{name}_jerk")):
            if (error := errors.get(f"{kind}.{part}", np.inf)) < 0.5:
                value = float(getattr(model, kind)[part])
                spread = float(np.exp(_NORMAL * error + _SLACK))
                found[f"acceleration_limit.{key}"] = Estimate(
                    value, value / spread, value * spread
                )
            elif kind == "acceleration":
                missing.append(f"no fast {motion}: {name} acceleration unknown; {DRIVE}")
    return found


def _result(
    ways: Sequence[_Ways],
    model: _Model,
    found: dict[str, Estimate],
    missing: Sequence[str],
    latency: float | None,
) -> Fit:
    names = {
        "base_lag": "actuator_lag.base", "arm_lag": "actuator_lag.arm",
        "acceleration": "acceleration_limit.linear", "jerk": "acceleration_limit.linear_jerk",
        "rotation_acceleration": "acceleration_limit.angular",
        "rotation_jerk": "acceleration_limit.angular_jerk",
    }  # fmt: skip
    known = {key: found[name].value for key, name in names.items() if name in found}
    if "sensor_latency.seconds" in found:
        jitter = found["sensor_latency.jitter"].value
        known["sensor_latency"] = found["sensor_latency.seconds"].value + jitter / 2.0
    response = ResponseModel(command_latency=max(0.0, latency or 0.0), **known)
    predicted = [way.predicted(model.velocities(way.log, _BASE_DRAWS)) for way in ways]
    return Fit(
        found, response, tuple(missing), tuple(way.times for way in ways),
        tuple(way.moved / way.seconds[:, np.newaxis] for way in ways),
        tuple(p / w.seconds[:, np.newaxis] for p, w in zip(predicted, ways, strict=True)),
    )  # fmt: skip


def _time(value: float, error: float) -> Estimate:
    half = _NORMAL * error + _SYSTEMATIC
    return Estimate(value, max(0.0, value - half), value + half)


def _deviation(variance: float, count: int) -> Estimate:
    value = float(np.sqrt(variance))
    share = _NORMAL / np.sqrt(2.0 * count / 1.6) + _SLACK
    return Estimate(value, value * (1.0 - share), value * (1.0 + share))


def _posterior(values: Array, weights: Array) -> Estimate:
    """Return mean and interval of a distribution on a grid, at least as wide as its cells."""
    mean = float(weights @ values)
    cumulated = np.concatenate([[0.0], np.cumsum(weights)])
    edges = np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])
    low, high = np.interp([0.025, 0.975], cumulated, edges)
    return Estimate(mean, float(low), float(high))


def _interpolated(values: Array, at: Array) -> Array:
    """Return values, shape (n, w), between their rows, shape (k, w)."""
    knots = np.arange(len(values))
    return np.stack([np.interp(at, knots, column) for column in values.T], axis=1)


def _derivatives(function: Callable[[Array], Array], z: Array) -> Array:
    steps = _STEP * np.eye(len(z))
    columns = [(function(z + step) - function(z - step)) / (2.0 * _STEP) for step in steps]
    return np.stack(columns, axis=1)


def _bounds(name: str) -> Array:
    if name == "latency":
        return np.array([-0.02, 0.6]) / _LATENCY
    kind = name.partition(".")[0]
    return {"lag": _TIMES, "acceleration": _LIMITS, "jerk": _JERKS}[kind]


def _get(model: _Model, name: str) -> float:
    """Return a parameter as the fit has it."""
    if name == "latency":
        return model.delays.latency / _LATENCY
    kind, _, part = name.partition(".")
    value = getattr(model, kind)
    return float(np.log(max(value, 1e-3) if not part else value[int(part)]))


def _changed(model: _Model, free: Sequence[str], z: Array) -> _Model:
    """Return a model with parameters as the fit has them."""
    fields = {"acceleration": model.acceleration.copy(), "jerk": model.jerk.copy()}
    delays, lag = model.delays, model.lag
    for name, value in zip(free, z.tolist(), strict=True):
        kind, _, part = name.partition(".")
        if name == "latency":
            delays = replace(delays, latency=value * _LATENCY)
        elif name == "lag":
            lag = float(np.exp(value))
        else:
            fields[kind][int(part)] = np.exp(value)
    return _Model(delays, lag, **fields)
