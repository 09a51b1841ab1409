"""The chain between commands and measurements of a robot, as the adapters have it.

Commands are late, lost, limited in acceleration and jerk, and lag; see `kinfeas.sim2real.adapters`.
The chain here is that of one robot, its delays are means, and its parameters may vary freely.
"""

from functools import cache

import numpy as np
from numba import njit

from kinfeas.backends.physics.drives import cubic
from kinfeas.control.response import advance
from kinfeas.core.spatial import Array
from kinfeas.sim2real.adapters.latency import durations


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
def moved_arm(targets, dt, lag, seconds=0.0):
    """Return joint positions at the ends of periods, (n, j), of active targets, shape (n, j).

    From each lagging target on, the arm moves on a cubic that ends at rest after `seconds`.
    """
    positions, seconds = np.empty_like(targets), max(seconds, dt)
    left = np.exp(-dt / lag) if lag > 0.0 else 0.0
    aim, speed = targets[0].copy(), np.zeros(targets.shape[1])
    for i in range(len(targets)):
        for k in range(targets.shape[1]):
            aim[k] = targets[i, k] + (aim[k] - targets[i, k]) * left
            at = positions[i - 1, k] if i > 0 else targets[0, k]
            positions[i, k], speed[k] = cubic(at, speed[k], aim[k] - at, seconds, dt)
    return positions


def arm_delay(dt: float, seconds: float) -> float:
    """Return by how much an arm on the cubics of `moved_arm` is late at constant velocity."""
    s = min(dt / seconds, 1.0) if seconds > 0.0 else 1.0
    return seconds * ((4.0 - 3.0 * s) / (6.0 - 6.0 * s + s * s) - s)


@cache
def uniform_numbers(draws: int, n: int) -> Array:
    """Return the same uniform numbers for each fit, shape (draws, n, 2)."""
    return np.random.default_rng(0).random((draws, n, 2))


@njit(cache=True)
def drawn_delays(uniform, dt, latency, jitter, lost):
    """Return one draw of `Delays` with these parameters, for n periods.

    Args:
        uniform: Uniform numbers in [0, 1), shape (n, 2).
        dt: Control period, seconds.
        latency: Minimum delay of a command, seconds.
        jitter: Maximum additional delay, seconds.
        lost: Probability that a command is lost.

    Returns:
        Weights of the commands of which the active one is mixed, the newest last, shape (n, k);
        and whether it was not lost, (n,).
    """
    n, slots = len(uniform), int(np.ceil((latency + jitter) / dt)) + 2
    begins = np.zeros((n, slots))
    for sent in range(n):
        arrival = sent + (latency + jitter * uniform[sent, 0]) / dt
        for k in range(min(slots, n - sent)):
            begins[sent + k, slots - 1 - k] = min(max(arrival - (sent + k), 0.0), 1.0)
    return durations(begins), uniform[:, 1] >= lost


@njit(cache=True)
def drawn_commands(commands, mixed, kept):
    """Return the active commands for one draw of the delays, shape (n, w)."""
    active = np.empty_like(commands)
    for i in range(len(commands)):
        for axis in range(commands.shape[1]):
            if kept[i]:
                value = 0.0
                for k in range(mixed.shape[1]):
                    weight = mixed[i, mixed.shape[1] - 1 - k]
                    if weight > 0.0:
                        value += weight * commands[max(i - k, 0), axis]
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
