"""Random numbers that depend only on the seed of an episode and its step.

They are hashes: rows of a batch are independent, and a run can resume at any step.
"""

import math
import zlib

import numpy as np
from numba import njit

EPISODE = np.uint64(0x8CB92BA72F3D8DD7)
"""Offset of seeds for numbers that are constant during an episode."""

_UNIFORM = 0xD1B54A32D192ED03
_SPREAD, _MASK = 0x9FB21C651E98DF25, 2**64 - 1


def salt(name: str, number: int) -> np.uint64:
    """Return an offset of seeds that separates streams by name and by number within a name."""
    return np.uint64((zlib.crc32(name.encode()) * _SPREAD + number) & _MASK)


@njit(cache=True)
def _hash(seed, counter):
    """Return a number in (0, 1]: SplitMix64 (Steele, Lea and Flood, OOPSLA 2014)."""
    z = seed + (counter + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) + 1.0) / 9007199254740992.0


@njit(cache=True)
def normal(seeds, steps, width):
    """Return standard normal numbers, shape (n, width), for seeds and steps of shape (n,)."""
    out = np.empty((len(seeds), width))
    for i in range(len(out)):
        for k in range(width):
            # Each step has sixteen counters of a seed, for eight numbers; Box-Muller transform.
            seed = seeds[i] + np.uint64(k // 8) * np.uint64(0xA0761D6478BD642F)
            counter = steps[i] * np.uint64(16) + np.uint64(2 * (k % 8))
            first, second = _hash(seed, counter), _hash(seed, counter + np.uint64(1))
            out[i, k] = math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)
    return out


@njit(cache=True)
def uniform(seeds, steps, width):
    """Return numbers in (0, 1], shape (n, width), for seeds and steps of shape (n,)."""
    out = np.empty((len(seeds), width))
    for i in range(len(out)):
        for k in range(width):
            counter = steps[i] * np.uint64(width) + np.uint64(k)
            out[i, k] = _hash(seeds[i] + np.uint64(_UNIFORM), counter)
    return out
