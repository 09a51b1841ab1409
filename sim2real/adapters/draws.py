"""Random numbers that depend on an episode's seed and step alone, and numbers drawn once for it.

They are hashes, so that no row of a batch depends on the others, and a run can go on anywhere.
"""

import math
import zlib
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinfeas.config import Interval
from kinfeas.core.spatial import Array

Seeds = NDArray[np.uint64]
Number = float | tuple[float, float] | list[float]
"""A number, or the range [low, high] from which each episode draws its own, uniformly."""

_UNIFORM, _EPISODE = 0xD1B54A32D192ED03, 0x8CB92BA72F3D8DD7
_SPREAD, _MASK = 0x9FB21C651E98DF25, 2**64 - 1


@dataclass(frozen=True)
class Range:
    """The numbers from `low` to `high`, ends included."""

    low: float
    high: float

    def draw(self, shares: Array) -> Array:
        """Return the numbers at `shares` of the range, in 0-1, of the same shape."""
        return self.low + (self.high - self.low) * shares


def read_range(name: str, value: object, within: Interval) -> Range:
    """Return the range that a parameter gives; a number is a range of no width.

    Raises:
        ValueError: If it is neither, or not `within` the interval.
    """
    ends = list(value) if isinstance(value, list | tuple) else [value, value]
    numbers = [end for end in ends if isinstance(end, int | float) and not isinstance(end, bool)]
    if len(ends) != 2 or len(numbers) != 2 or not all(end in within for end in numbers):
        allowed = f"a finite number {within} or a range [low, high] of such"
        raise ValueError(f"{name} is {value!r}, must be {allowed}")
    low, high = map(float, numbers)
    if low > high:
        raise ValueError(f"{name} is {value!r}, but a range must ascend")
    return Range(low, high)


def salt(name: str, number: int) -> np.uint64:
    """Return what sets the seeds of a drawer apart from those of others.

    Args:
        name: What kind of drawer it is; one without a name keeps the seeds as they are.
        number: How many of its kind there were before it.
    """
    return np.uint64((zlib.crc32(name.encode()) * _SPREAD + number) & _MASK)


def normal(seeds: Seeds, steps: Seeds, width: int) -> Array:
    """Return standard normal numbers, shape (n, width), for seeds and steps of shape (n,)."""
    drawn = np.empty((len(seeds), width))
    _normal(seeds, steps, drawn)
    return drawn


def uniform(seeds: Seeds, steps: Seeds, width: int) -> Array:
    """Return numbers in (0, 1], shape (n, width), for seeds and steps of shape (n,)."""
    drawn = np.empty((len(seeds), width))
    _uniforms(seeds + np.uint64(_UNIFORM), steps, drawn)
    return drawn


def once(seeds: Seeds, width: int) -> Array:
    """Return numbers in (0, 1], shape (n, width), that stay for the whole episode."""
    return uniform(seeds + np.uint64(_EPISODE), np.zeros_like(seeds), width)


@njit(cache=True)
def _normal(seeds, steps, out):
    # By the method of Box and Muller.
    for i in range(len(out)):
        for k in range(out.shape[1]):
            # A step has sixteen numbers of a seed, which make eight.
            seed = seeds[i] + np.uint64(k // 8) * np.uint64(0xA0761D6478BD642F)
            counter = steps[i] * np.uint64(16) + np.uint64(2 * (k % 8))
            first, second = _hash(seed, counter), _hash(seed, counter + np.uint64(1))
            out[i, k] = math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)


@njit(cache=True)
def _uniforms(seeds, steps, out):
    for i in range(len(out)):
        for k in range(out.shape[1]):
            out[i, k] = _hash(seeds[i], steps[i] * np.uint64(out.shape[1]) + np.uint64(k))


@njit(cache=True)
def _hash(seed, counter):
    """Return a number in (0, 1]: SplitMix64 (Steele, Lea and Flood, OOPSLA 2014)."""
    z = seed + (counter + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) + 1.0) / 9007199254740992.0
