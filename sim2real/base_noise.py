"""Noise on the base velocity, as training and deployment studies use it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinfeas.backend import Backend, Grip, Gripping, Resumable, RobotState, Stochastic
from kinfeas.errors import KinfeasError
from kinfeas.spatial import Array


class BaseNoise:
    """Adds Gaussian noise to the base's planar velocity and to its turning.

    A base that stands still and is commanded to do so is disturbed as well. The draws are a hash
    of the episode's seed and the step's number, so that they do not depend on the batch.
    """

    def __init__(self, backend: Backend, *, linear: float = 0.015, angular: float = 0.015) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the disturbed commands.
            linear: Standard deviation of the velocity along each planar axis, m/s.
            angular: Standard deviation of the turning rate, rad/s.

        Raises:
            KinfeasError: If a deviation is negative or not finite.
        """
        for name, value in (("linear", linear), ("angular", angular)):
            if not 0.0 <= value < math.inf:
                raise KinfeasError(f"base_noise: {name} is {value}, must be finite and at least 0")
        self.backend, self.linear, self.angular = backend, linear, angular
        self.seeds = np.empty(0, dtype=np.uint64)
        self.steps = np.empty(0, dtype=np.uint64)

    def seed(self, seeds: NDArray[np.uint64], rows: NDArray[np.intp]) -> None:
        """Begin new episodes with one seed each, shape (m,), in the m `rows`."""
        if len(rows) and rows.max() >= len(self.seeds):
            grown = int(rows.max()) + 1
            self.seeds, self.steps = np.resize(self.seeds, grown), np.resize(self.steps, grown)
        self.seeds[rows], self.steps[rows] = seeds, 0
        if isinstance(self.backend, Stochastic):
            self.backend.seed(seeds + np.uint64(1), rows)

    def reset(
        self, base_pose: Array, joint_positions: Array, rows: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Pass on; shapes as in `Backend`."""
        return self.backend.reset(base_pose, joint_positions, rows)

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Disturb the twist and pass it on; shapes as in `Backend`."""
        noise = np.empty((len(base_twist), 3))
        _normal(self.seeds[: len(noise)], self.steps[: len(noise)], noise)
        self.steps += np.uint64(1)
        disturbed = base_twist.copy()
        disturbed[:, :2] += noise[:, :2] * self.linear
        disturbed[:, 5] += noise[:, 2] * self.angular
        return self.backend.step(disturbed, joint_targets, dt)

    def grip(self, grip: Grip, rows: NDArray[np.intp]) -> None:
        """Pass on to a backend that has grippers."""
        if isinstance(self.backend, Gripping):
            self.backend.grip(grip, rows)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return how far the draws have come, beside the state of the wrapped backend."""
        inner = self.backend.snapshot() if isinstance(self.backend, Resumable) else {}
        steps = self.steps.copy()  # which `step` counts up in place
        return {**inner, "base_noise_seeds": self.seeds.copy(), "base_noise_steps": steps}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Take on a state that `snapshot` returned and return what it measures.

        Raises:
            KinfeasError: If the wrapped backend cannot go on from a snapshot.
        """
        if not isinstance(self.backend, Resumable):
            raise KinfeasError("base_noise: the wrapped backend cannot be restored")
        self.seeds = snapshot["base_noise_seeds"].copy()
        self.steps = snapshot["base_noise_steps"].copy()
        return self.backend.restore(snapshot)

    def close(self) -> None:
        """Close the wrapped backend."""
        self.backend.close()


@njit(cache=True)
def _normal(seeds, steps, out):
    """Write standard normal draws, shape (n, 3), as functions of seed and step."""
    for i in range(len(out)):
        for k in range(out.shape[1]):
            counter = steps[i] * np.uint64(16) + np.uint64(2 * k)
            first, second = _uniform(seeds[i], counter), _uniform(seeds[i], counter + np.uint64(1))
            out[i, k] = math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)


@njit(cache=True)
def _uniform(seed, counter):
    """Return a number in (0, 1]: SplitMix64 (Steele, Lea and Flood, OOPSLA 2014)."""
    z = seed + (counter + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) + 1.0) / 9007199254740992.0
