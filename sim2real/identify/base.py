"""The fit of a base's response to its measured track."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Literal

import numpy as np
from scipy.optimize import Bounds, least_squares

from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify.model import BaseModel, Delays, Track
from kinfeas.sim2real.identify.noise import jumps, spread_of, widened
from kinfeas.sim2real.identify.statistics import MOVES, derivatives, standard_errors, time_blocks

LATENCY = 0.05
"""Seconds, the unit of a latency in fits; other parameters are logarithms."""

TIMES = np.log([1e-3, 3.0])
"""Bounds of time constants."""

BASE_DRAWS = 8
"""Draws of delays for the mean velocity of a base."""

# A limit is left out if its error is large and half the sum of squares hardly grows without it.
_VAGUE, _SHOWN = 0.3, 4.0
_USUAL_LIMIT, _USUAL_JERK = 1.0, 8.0  # m/s^2 and m/s^3, within a factor e, as also of rotation
_LIMITS, _JERKS = np.log([0.05, 50.0]), np.log([0.5, 300.0])


class BaseProblem:
    """The fit of a base's response to its tracks in some logs."""

    def __init__(self, tracks: Sequence[Track], dt: float) -> None:
        self._tracks, self._dt = tracks, dt
        fastest = np.max([np.abs(track.log.twists).max(axis=0) for track in tracks], axis=0)
        self.moves = bool((fastest > MOVES).any())
        self.parts = np.array([fastest[:2].max() > MOVES, fastest[2] > MOVES])
        self._scale = [np.sqrt(track.squares)[:, np.newaxis] for track in tracks]
        self._kept = [np.ones(len(track.moved), dtype=np.bool_) for track in tracks]
        self._deviation = np.ones(3)
        self._blocks = np.repeat(time_blocks([track.times for track in tracks]), 3)

    def fit(self, arm: Delays | None, error: float) -> tuple[BaseModel, dict[str, float]]:
        """Return the model and the standard errors of its parameters, relative but for times.

        Args:
            arm: Delays that the arm shows.
            error: Standard error of their latency, seconds.
        """
        none = np.full(2, np.inf)
        model = BaseModel(arm or Delays(0.0), 0.0, none, none)
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
            tried, cost = self._solve(BaseModel(delays, lag, *limits), names, "soft_l1")
            if cost < least:
                best, least = tried, cost
        self._draws = BASE_DRAWS
        for _ in range(2):
            self._normalise(best)
            best, least = self._solve(best, free, "linear")
        if arm is not None:
            errors = self._errors(best, free)
            apart = abs(best.delays.latency - arm.latency)
            if apart <= max(0.015, 3.0 * np.hypot(errors["latency"], error)):
                self._prior = arm.latency, max(error, 0.001)
                best, least = self._solve(best, free, "linear")
        errors = self._errors(best, free)
        for name in [name for name in names if "." in name]:
            kind, _, part = name.partition(".")
            limits = getattr(best, kind).copy()
            limits[int(part)] = np.inf
            fewer = [other for other in free if other != name]
            if errors[name] > _VAGUE:
                without, cost = self._solve(replace(best, **{kind: limits}), fewer, "linear")
                if cost - least < _SHOWN:
                    best, least, free = without, cost, fewer
                    errors = self._errors(best, free)
        return best, errors

    _prior: tuple[float, float] | None = None  # latency and its standard error
    _draws = 0  # of delays

    def _normalise(self, model: BaseModel) -> None:
        """Estimate the noise of each axis, and leave out jumps."""
        predicted = self._predicted(model)
        rests = [
            (p - track.moved) / scale
            for p, track, scale in zip(predicted, self._tracks, self._scale, strict=True)
        ]
        self._deviation = spread_of(np.concatenate(rests))
        self._kept = [
            ~widened(jumps(rest * scale, scale * self._deviation, p / t.seconds[:, np.newaxis]))
            for p, t, rest, scale in zip(predicted, self._tracks, rests, self._scale, strict=True)
        ]

    def _predicted(self, model: BaseModel) -> list[Array]:
        return [track.predicted(model.velocities(track.log, self._draws)) for track in self._tracks]

    @property
    def agrees(self) -> bool:
        """Whether base and arm show the same latency."""
        return self._prior is not None

    def _residuals(self, model: BaseModel) -> Array:
        columns = self._predicted(model), self._tracks, self._scale, self._kept
        parts = [
            ((p - track.moved) / (scale * self._deviation) * kept[:, np.newaxis]).ravel()
            for p, track, scale, kept in zip(*columns, strict=True)
        ]
        return np.concatenate([*parts, self._prior_residuals(model)])

    def _prior_residuals(self, model: BaseModel) -> Array:
        """Return the residuals of priors, of a fixed number."""
        parts = []
        for values, usual in ((model.acceleration, _USUAL_LIMIT), (model.jerk, _USUAL_JERK)):
            limited = np.isfinite(values)
            parts.append(np.where(limited, np.log(np.where(limited, values, usual) / usual), 0.0))
        if self._prior is not None:
            latency, error = self._prior
            parts.append(np.array([(model.delays.latency - latency) / error]))
        return np.concatenate(parts)

    def _solve(
        self, model: BaseModel, free: Sequence[str], loss: Literal["linear", "soft_l1"]
    ) -> tuple[BaseModel, float]:
        bounds = np.array([bounds_of(name) for name in free])
        lower, upper = bounds.T
        start = np.clip([_get(model, name) for name in free], lower + 1e-6, upper - 1e-6)

        def residuals(z: Array) -> Array:
            return self._residuals(_changed(model, free, z))

        solution = least_squares(
            residuals, start, jac=partial(derivatives, residuals), bounds=Bounds(*bounds.T),
            loss=loss, f_scale=3.0, max_nfev=20, xtol=1e-3, ftol=1e-6,
        )  # fmt: skip
        return _changed(model, free, solution.x), float(solution.cost)

    def _errors(self, model: BaseModel, free: Sequence[str]) -> dict[str, float]:
        z = np.array([_get(model, name) for name in free])

        def residuals(z: Array) -> Array:
            return self._residuals(_changed(model, free, z))

        beside = np.arange(len(self._prior_residuals(model))) + self._blocks.max() + 1
        blocks = np.concatenate([self._blocks, beside])
        errors = standard_errors(residuals(z), derivatives(residuals, z), blocks)
        errors = np.where([name == "latency" for name in free], errors * LATENCY, errors)
        return dict(zip(free, errors.tolist(), strict=True))


def bounds_of(name: str) -> Array:
    """Return the bounds of a parameter as a fit has it, shape (2,)."""
    if name == "latency":
        return np.array([0.0, 0.6]) / LATENCY
    kind = name.partition(".")[0]
    return {"lag": TIMES, "acceleration": _LIMITS, "jerk": _JERKS}[kind]


def _get(model: BaseModel, name: str) -> float:
    if name == "latency":
        return model.delays.latency / LATENCY
    kind, _, part = name.partition(".")
    value = getattr(model, kind)
    return float(np.log(max(value, 1e-3) if not part else value[int(part)]))


def _changed(model: BaseModel, free: Sequence[str], z: Array) -> BaseModel:
    """Return a model with parameters as the fit has them."""
    fields = {"acceleration": model.acceleration.copy(), "jerk": model.jerk.copy()}
    delays, lag = model.delays, model.lag
    for name, value in zip(free, z.tolist(), strict=True):
        kind, _, part = name.partition(".")
        if name == "latency":
            delays = replace(delays, latency=value * LATENCY)
        elif name == "lag":
            lag = float(np.exp(value))
        else:
            fields[kind][int(part)] = np.exp(value)
    return BaseModel(delays, lag, **fields)
