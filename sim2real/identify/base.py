"""The fit of a base's response to its measured track."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, least_squares

from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify.model import BaseModel, Delays, Track
from kinfeas.sim2real.identify.statistics import (
    MOVES,
    NORMAL,
    derivatives,
    jumps,
    posterior,
    spread_of,
    standard_errors,
    time_blocks,
    widened,
)

LATENCY_UNIT = 0.05
"""Unit of a latency in fits, seconds; other parameters are logarithms."""

LATENCIES, TIMES = np.array([0.0, 0.6]) / LATENCY_UNIT, np.log([1e-3, 3.0])
"""Bounds of latencies and of time constants in fits."""

BASE_DRAWS = 8
"""Draws of delays for the mean velocity of a base."""

# A limit is left out if its relative error exceeds the first, or it is at its bound, and if half
# the sum of squares grows without it by less than the second.
_VAGUE, _SHOWN = 0.3, 4.0
_USUAL_LIMIT, _USUAL_JERK = 1.0, 8.0  # means of priors, m/s^2 and m/s^3, or rad; 1 sigma: factor e
_COMPARED = np.arange(0.01, 0.42, 0.02)  # latencies that are compared without an arm, s
_LEAST_NOISE = 1e-3  # of a base's velocity, m/s and rad/s; with less, fits would trust every detail
_TRUST = 0.25  # weight of the likelihood of `_COMPARED`, since residuals are correlated
_BOUNDS = {
    "latency": LATENCIES, "lag": TIMES,
    "acceleration": np.log([0.05, 50.0]), "jerk": np.log([0.5, 300.0]),
}  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """A parameter of a `BaseModel`; in fits, a latency in `LATENCY_UNIT`, others as logarithms.

    Limits of acceleration and jerk are those of translation, `part` 0, or of rotation, 1.
    """

    kind: Literal["latency", "lag", "acceleration", "jerk"]
    part: int = 0

    def of(self, model: BaseModel) -> float:
        """Return its value in a model."""
        if self.kind == "latency":
            return model.delays.latency / LATENCY_UNIT
        if self.kind == "lag":
            return float(np.log(max(model.lag, 1e-3)))
        return float(np.log(getattr(model, self.kind)[self.part]))

    def put(self, model: BaseModel, value: float) -> BaseModel:
        """Return a model with another value, inf for no limit."""
        if self.kind == "latency":
            return replace(model, delays=replace(model.delays, latency=value * LATENCY_UNIT))
        if self.kind == "lag":
            return replace(model, lag=float(np.exp(value)))
        limits = getattr(model, self.kind).copy()
        limits[self.part] = np.exp(value)
        return replace(model, **{self.kind: limits})


LATENCY, LAG = Parameter("latency"), Parameter("lag")


@dataclass(frozen=True)
class BaseFit:
    """A fitted base."""

    model: BaseModel
    # standard errors of the parameters that the logs show: of the latency in s, of others relative
    errors: dict[Parameter, float] = field(default_factory=dict)
    agrees: bool = False  # whether base and arm show the same latency


@dataclass(frozen=True, eq=False)
class Comparison:
    """How models are compared with measured tracks."""

    draws: int  # of delays; 0 for the mean active commands
    deviation: Array  # noise of each axis, shape (3,), m/s and rad/s
    kept: Sequence[NDArray[np.bool_]]  # whether displacements of each track have no jump, (k,)
    latency: tuple[float, float] | None = None  # the latency by an arm, and its error, seconds


class BaseProblem:
    """The fit of a base's response to its tracks in some logs."""

    def __init__(self, tracks: Sequence[Track]) -> None:
        self._tracks = tracks
        fastest = np.max([np.abs(track.log.twists).max(axis=0) for track in tracks], axis=0)
        self.moves = bool((fastest > MOVES).any())
        self._parts = np.array([fastest[:2].max() > MOVES, fastest[2] > MOVES])
        self._scale = [np.sqrt(track.squares)[:, np.newaxis] for track in tracks]
        self._blocks = np.repeat(time_blocks([track.times for track in tracks]), 3)

    def fit(self, arm: Delays | None, error: float) -> BaseFit:
        """Return the fitted base, for the delays of an arm and the `error` of their latency, s."""
        unlimited = np.full(2, np.inf)
        model = BaseModel(arm or Delays(0.0), 0.0, unlimited, unlimited)
        if not self.moves:
            return BaseFit(model)
        limits = [
            Parameter(kind, part)
            for part in np.flatnonzero(self._parts).tolist()
            for kind in ("acceleration", "jerk")
        ]
        free = [LATENCY, LAG, *limits]
        comparison = self.comparison(model, 0)
        starts = self._starts(model, (0.03, 0.1, 0.2) if arm is None else (arm.latency,))
        solutions = [self.solve(start, free[1:], comparison, loss="soft_l1") for start in starts]
        best, least = min(solutions, key=lambda solved: solved[1])
        # Without an arm there is no jitter, so that all draws are the same.
        draws, latency_error = BASE_DRAWS if arm is not None else 1, None
        for _ in range(2):
            comparison = self.comparison(best, draws)
            best, least = self.solve(best, free, comparison)
        if arm is None:
            best, least, latency_error = self._likely(best, free[1:], comparison)
        errors = self.errors(best, free, comparison)
        if arm is not None:
            difference = abs(best.delays.latency - arm.latency)
            if difference <= max(0.015, 3.0 * np.hypot(errors[LATENCY], error)):
                comparison = replace(comparison, latency=(arm.latency, max(error, 0.001)))
                best, least = self.solve(best, free, comparison)
                errors = self.errors(best, free, comparison)
        for limit in limits:
            if errors[limit] > _VAGUE or limit.of(best) > _BOUNDS[limit.kind][1] - _VAGUE:
                fewer = [other for other in free if other != limit]
                solved = fewer if arm is not None else fewer[1:]  # without the latency
                without, cost = self.solve(limit.put(best, np.inf), solved, comparison)
                if cost - least < _SHOWN:
                    best, least, free = without, cost, fewer
                    errors = self.errors(best, free, comparison)
        if latency_error is not None:
            errors[LATENCY] = latency_error
        return BaseFit(best, errors, agrees=comparison.latency is not None)

    def _likely(
        self, best: BaseModel, free: Sequence[Parameter], comparison: Comparison
    ) -> tuple[BaseModel, float, float]:
        """Return the model at the mean of likely latencies, its cost, and their error, seconds.

        Without an arm, one best latency says little: limits of acceleration hide the part within a
        period, and a lag looks alike.
        """
        models = [LATENCY.put(best, latency / LATENCY_UNIT) for latency in _COMPARED]
        costs = np.array([self.solve(model, free, comparison)[1] for model in models])
        weights = np.exp(_TRUST * (costs.min() - costs))
        estimate = posterior(_COMPARED, weights / weights.sum())
        model = LATENCY.put(best, estimate.value / LATENCY_UNIT)
        best, least = self.solve(model, free, comparison)
        bounded = estimate.high < _COMPARED[-2]
        error = max(estimate.high - estimate.value, estimate.value - estimate.low) / NORMAL
        return best, least, error if bounded else np.inf

    def _starts(self, model: BaseModel, latencies: Sequence[float]) -> list[BaseModel]:
        return [
            BaseModel(
                replace(model.delays, latency=latency), lag,
                np.where(self._parts, limit, np.inf), np.where(self._parts, 10.0, np.inf),
            )
            for latency, lag, limit in product(latencies, (0.03, 0.1, 0.3), (0.4, 1.0, 2.5))
        ]  # fmt: skip

    def comparison(self, model: BaseModel, draws: int) -> Comparison:
        """Return a comparison with the noise and the jumps that a model does not explain."""
        predicted = self._predicted(model, draws)
        residuals = [
            (p - track.moved) / scale
            for p, track, scale in zip(predicted, self._tracks, self._scale, strict=True)
        ]
        deviation = np.maximum(spread_of(np.concatenate(residuals)), _LEAST_NOISE)
        kept = [
            ~widened(jumps(r * scale, scale * deviation, p / t.seconds[:, np.newaxis]))
            for p, t, r, scale in zip(predicted, self._tracks, residuals, self._scale, strict=True)
        ]
        return Comparison(draws, deviation, kept)

    def solve(
        self,
        model: BaseModel,
        free: Sequence[Parameter],
        comparison: Comparison,
        loss: Literal["linear", "soft_l1"] = "linear",
    ) -> tuple[BaseModel, float]:
        """Return a model with fitted `free` parameters, and its cost, half the sum of squares."""
        lower, upper = np.array([_BOUNDS[parameter.kind] for parameter in free]).T
        start = np.clip([each.of(model) for each in free], lower + 1e-6, upper - 1e-6)
        residuals = partial(self.residuals, model, free, comparison)
        solution = least_squares(
            residuals, start, jac=partial(derivatives, residuals), bounds=Bounds(lower, upper),
            loss=loss, f_scale=3.0, max_nfev=20, xtol=1e-3, ftol=1e-6,
        )  # fmt: skip
        return _changed(model, free, solution.x), float(solution.cost)

    def errors(
        self, model: BaseModel, free: Sequence[Parameter], comparison: Comparison
    ) -> dict[Parameter, float]:
        """Return the standard errors of the free parameters, as in `BaseFit`."""
        z = np.array([parameter.of(model) for parameter in free])
        residuals = partial(self.residuals, model, free, comparison)
        prior_blocks = np.arange(len(_prior_residuals(model, comparison))) + self._blocks.max() + 1
        blocks = np.concatenate([self._blocks, prior_blocks])
        units = np.array([LATENCY_UNIT if each == LATENCY else 1.0 for each in free])
        errors = units * standard_errors(residuals(z), derivatives(residuals, z), blocks)
        return dict(zip(free, errors.tolist(), strict=True))

    def residuals(
        self, model: BaseModel, free: Sequence[Parameter], comparison: Comparison, z: Array
    ) -> Array:
        """Return the normalised residuals of all displacements, then those of priors.

        Free parameters of the model have the values `z`.
        """
        model = _changed(model, free, z)
        predicted = self._predicted(model, comparison.draws)
        parts = [
            ((p - track.moved) / (scale * comparison.deviation) * kept[:, np.newaxis]).ravel()
            for p, track, scale, kept in zip(
                predicted, self._tracks, self._scale, comparison.kept, strict=True
            )
        ]
        return np.concatenate([*parts, _prior_residuals(model, comparison)])

    def _predicted(self, model: BaseModel, draws: int) -> list[Array]:
        return [track.predicted(model.velocities(track.log, draws)) for track in self._tracks]


def _prior_residuals(model: BaseModel, comparison: Comparison) -> Array:
    """Return the residuals of priors; their number depends on the comparison only."""
    parts = []
    for values, usual in ((model.acceleration, _USUAL_LIMIT), (model.jerk, _USUAL_JERK)):
        limited = np.isfinite(values)
        parts.append(np.where(limited, np.log(np.where(limited, values, usual) / usual), 0.0))
    if comparison.latency is not None:
        latency, error = comparison.latency
        parts.append(np.array([(model.delays.latency - latency) / error]))
    return np.concatenate(parts)


def _changed(model: BaseModel, free: Sequence[Parameter], z: Array) -> BaseModel:
    for parameter, value in zip(free, z.tolist(), strict=True):
        model = parameter.put(model, value)
    return model
