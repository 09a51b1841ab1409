"""Estimates, and the statistics of fits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.spatial import Array

DRIVE = "drive the pattern of `kinfeas identify --drive`"
"""End of the sentences on what records do not show."""

NORMAL = 1.96
"""Half of a 95 % interval, in standard deviations."""

BLOCK = 2.0
"""Seconds of residuals that depend on each other."""

MOVES = 0.02
"""What counts as motion: m/s and rad/s, or m and rad of a joint."""

SLACK_SECONDS, SLACK, SLACK_JERK, SLACK_JOINTS = 0.008, 0.03, 0.4, 0.15
"""Smallest half of the interval of a time, and of other numbers as a fraction.

A link between robot and record smooths jerk, and noise of joints, by as much.
"""

_STEP = 0.02  # of parameters, for derivatives


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

    Those below half a period cannot be told from zero.
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
    """Return the numbers of the blocks of `BLOCK` seconds that times of several logs are in."""
    blocks = [np.floor(seconds / BLOCK).astype(np.intp) for seconds in times]
    firsts = np.cumsum([0, *(block.max() + 1 for block in blocks[:-1])])
    return np.concatenate([block + first for block, first in zip(blocks, firsts, strict=True)])


def standard_errors(residuals: Array, derivatives: Array, blocks: NDArray[np.intp]) -> Array:
    """Return standard errors of parameters, shape (p,), for residuals that depend within blocks.

    These are normalised residuals, their derivatives, (r, p), and the block of each, (r,).
    """
    inverse = np.linalg.pinv(derivatives.T @ derivatives)
    scores = np.zeros((int(blocks.max()) + 1, derivatives.shape[1]))
    np.add.at(scores, blocks, derivatives * np.clip(residuals, -5.0, 5.0)[:, np.newaxis])
    robust = inverse @ (scores.T @ scores) @ inverse
    return np.sqrt(np.maximum(np.diag(robust), np.diag(inverse)))


def derivatives(function: Callable[[Array], Array], z: Array) -> Array:
    """Return central differences of a function, shape (r, p), by parameters, shape (p,)."""
    steps = _STEP * np.eye(len(z))
    columns = [(function(z + step) - function(z - step)) / (2.0 * _STEP) for step in steps]
    return np.stack(columns, axis=1)
