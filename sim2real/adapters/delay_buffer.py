"""What is on its way: the last few commands or measurements of each row, the newest at the end."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinfeas.config import Interval
from kinfeas.core.spatial import Array

_EXACT = 1e-6  # of a control period: rounding must not make a whole number of them a fraction
_INSTANT = 1e-7  # s, likewise

LATEST = Interval(low=0.0, high=60.0)
"""Seconds for which anything may be on its way: what is has to be remembered."""


def filled(values: NDArray[Any], slots: int) -> NDArray[Any]:
    """Return lines that hold the same in all slots, shape (n, ...) -> (n, slots, ...)."""
    return np.repeat(values[:, np.newaxis], slots, axis=1)


def pushed(line: NDArray[Any], values: NDArray[Any], slots: int) -> NDArray[Any]:
    """Return lines, shape (n, s, ...), with `values`, (n, ...), at the end; at most `slots`."""
    return np.concatenate([line, values[:, np.newaxis]], axis=1)[:, -slots:]


def slots_for(seconds: float, dt: float) -> int:
    """Return how many entries, one each `dt`, a line needs so that the first is `seconds` old."""
    return int(np.ceil(seconds / dt)) + 2


def in_force(arrivals: Array, now: Array, dt: float) -> Array:
    """Return for which share of the next `dt` seconds each command is in force.

    The newest of the commands that have arrived is.

    Args:
        arrivals: When they arrive, seconds, in the order in which they were sent, shape (n, s).
        now: Time of each row, seconds, shape (n,).
        dt: Seconds.

    Returns:
        Shares, shape (n, s); those of a row make 1.
    """
    # Whole and half periods come out as such: rounding is far below what matters.
    begins = np.clip(np.round((arrivals - now[:, np.newaxis]) / dt / _EXACT) * _EXACT, 0.0, 1.0)
    shares = np.empty_like(begins)
    _share(begins, shares)
    return shares


def mixed(line: Array, shares: Array, turning: NDArray[np.bool_]) -> Array:
    """Return the means of lines, shape (n, s, w), by `shares`, (n, s) -> (n, w).

    Args:
        line: Commands; a share of 1 gives its command to the bit.
        shares: Weights; those of a row make 1.
        turning: Which of the w numbers are angles of continuous joints, shape (w,).
    """
    means = np.empty((len(line), line.shape[2]))
    _mix(line, shares, turning, means)
    return means


def around(times: Array, moment: Array) -> tuple[NDArray[np.intp], Array]:
    """Return between which measurements a moment lies.

    Args:
        times: When they were taken, seconds, ascending, shape (n, s); -inf before an episode.
        moment: Seconds, shape (n,).

    Returns:
        Index of the one before, shape (n,), and how far on the way to the next one it is, (n,),
        in [0, 1).
    """
    index, share = np.empty(len(times), dtype=np.intp), np.empty(len(times))
    _find(times, moment, _INSTANT, index, share)
    return index, share


@njit(cache=True)
def _share(begins, shares):
    for i in range(len(begins)):
        end = 1.0
        for k in range(begins.shape[1] - 1, -1, -1):
            shares[i, k] = max(end - begins[i, k], 0.0)
            end = min(end, begins[i, k])
        shares[i, 0] += end  # what was in force before all of them


@njit(cache=True)
def _mix(line, shares, turning, means):
    for i in range(len(line)):
        first = 0
        while shares[i, first] == 0.0:
            first += 1
        for k in range(line.shape[2]):
            mean = line[i, first, k]
            for j in range(first + 1, line.shape[1]):
                if shares[i, j] > 0.0:
                    way = line[i, j, k] - line[i, first, k]
                    if turning[k]:
                        way -= 2.0 * np.pi * np.round(way / (2.0 * np.pi))
                    mean += shares[i, j] * way
            means[i, k] = mean


@njit(cache=True)
def _find(times, moment, tolerance, index, share):
    for i in range(len(times)):
        k = times.shape[1] - 1
        while k > 0 and times[i, k] > moment[i] + tolerance:
            k -= 1
        index[i], share[i] = k, 0.0
        if k + 1 < times.shape[1] and times[i, k] > -np.inf:
            way = (moment[i] - times[i, k]) / (times[i, k + 1] - times[i, k])
            if moment[i] - times[i, k] > tolerance:
                share[i] = way
