"""The chain between commands and measurements of a robot, as the adapters have it.

Commands are late, lost, limited in acceleration and jerk, and lag; see `kinfeas.sim2real.adapters`.
The chain here is that of one robot, its delays are means, and its parameters may vary freely.
"""

from functools import cache

import numpy as np
from numba import njit

from kinfeas.control.response import advance
from kinfeas.core.spatial import Array

_OFFSETS = (np.arange(32) + 0.5) / 32.0
"""Fractions of a period at which the active command is looked up."""

_NARROW = 0.125  # periods of jitter at least, so that weights change smoothly with the latency
_LOST = 16  # commands lost in a row that are counted


def delay_weights(latency: float, jitter: float, lost: float, dt: float) -> Array:
    """Return the mean weight of each command in a period, shape (k,), that of the newest first.

    Args:
        latency: Minimum delay of a command, seconds.
        jitter: Width of the uniform distribution of additional delays, seconds.
        lost: Probability that a command is lost.
        dt: Control period, seconds.
    """
    width = max(jitter, _NARROW * dt)
    first = latency + 0.5 * (jitter - width)
    count = int(np.ceil(max(first + width, 0.0) / dt)) + 2
    ages = (_OFFSETS[:, np.newaxis] + np.arange(count)) * dt
    arrived = np.clip((ages - first) / width, 0.0, 1.0)
    earlier = np.cumprod(1.0 - arrived, axis=1)
    active = arrived * np.concatenate([np.ones((len(ages), 1)), earlier[:, :-1]], axis=1)
    weights: Array = active.mean(axis=0)
    return np.convolve(weights, (1.0 - lost) * lost ** np.arange(_LOST)) if lost > 0.0 else weights


def mean_delay(weights: Array, dt: float) -> float:
    """Return the mean delay of a command, seconds, by its weights of `delay_weights`."""
    return float(weights @ np.arange(len(weights))) * dt


@njit(cache=True)
def delayed(commands, weights):
    """Return the mean active commands of commands, both (n, w); the first one was sent before."""
    active = np.zeros_like(commands)
    for i in range(len(commands)):
        for k in range(len(weights)):
            sent = max(i - k, 0)
            for axis in range(commands.shape[1]):
                active[i, axis] += weights[k] * commands[sent, axis]
    return active


@njit(cache=True)
def moved_base(commands, dt, lag, acceleration, jerk):
    """Return mean velocities by period, shape (n, 3), of active planar velocities, (n, 3).

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
def moved_arm(targets, dt, lag):
    """Return joint positions at the ends of periods, (n, j), of active targets, shape (n, j)."""
    positions = np.empty_like(targets)
    left = np.exp(-dt / lag) if lag > 0.0 else 0.0
    for i in range(len(targets)):
        for k in range(targets.shape[1]):
            before = positions[i - 1, k] if i > 0 else targets[0, k]
            positions[i, k] = targets[i, k] + (before - targets[i, k]) * left
    return positions


@cache
def uniform_numbers(draws: int, n: int) -> Array:
    """Return the same uniform numbers for each fit, shape (draws, n, 2)."""
    return np.random.default_rng(0).random((draws, n, 2))


@njit(cache=True)
def drawn_delays(uniform, dt, latency, jitter, lost):
    """Return one draw of the delays whose mean `delay_weights` returns, for n periods.

    Args:
        uniform: Uniform numbers in [0, 1), shape (n, 2).
        dt: Control period, seconds.
        latency: As the others, those of `delay_weights`.
        jitter: See there.
        lost: See there.

    Returns:
        Weights of the commands of which the active one is mixed, the newest first, shape (n, k);
        and whether it was not lost, (n,).
    """
    n = len(uniform)
    slots = int(np.ceil((latency + jitter) / dt)) + 2
    mixed = np.zeros((n, slots))
    arrivals = np.empty(n)
    for i in range(n):
        arrivals[i] = i + (latency + jitter * uniform[i, 0]) / dt
        end = 1.0
        for k in range(slots):
            sent = i - k
            begin = min(max(arrivals[sent] - i, 0.0), 1.0) if sent >= 0 else 0.0
            mixed[i, k] = max(end - begin, 0.0)
            end = min(end, begin)
    return mixed, uniform[:, 1] >= lost


@njit(cache=True)
def drawn_commands(commands, mixed, kept):
    """Return the active commands for one draw of the delays, shape (n, w)."""
    active = np.empty_like(commands)
    for i in range(len(commands)):
        for axis in range(commands.shape[1]):
            if kept[i]:
                value = 0.0
                for k in range(mixed.shape[1]):
                    if mixed[i, k] > 0.0:
                        value += mixed[i, k] * commands[max(i - k, 0), axis]
                active[i, axis] = value
            else:
                active[i, axis] = active[i - 1, axis] if i > 0 else commands[0, axis]
    return active


@njit(cache=True)
def mean_moved_base(commands, dt, latency, jitter, lost, lag, acceleration, jerk, uniform):
    """Return the mean of `moved_base`, (n, 3), over draws by uniform numbers, (draws, n, 2)."""
    total = np.zeros_like(commands)
    for numbers in uniform:
        mixed, kept = drawn_delays(numbers, dt, latency, jitter, lost)
        active = drawn_commands(commands, mixed, kept)
        total += moved_base(active, dt, lag, acceleration, jerk)
    return total / len(uniform)
