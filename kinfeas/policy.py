"""What a base policy is, and the trained network that plays one without torch."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinfeas.errors import KinfeasError
from kinfeas.spatial import Array


@dataclass(frozen=True)
class Situation:
    """All that a policy may look at, for n robots.

    Attributes:
        observation: What a learned policy sees, shape (n, 21 + j).
        base_pose: World pose of the base, shape (n, 7).
        ee_pose: Achieved world pose of the EE, shape (n, 7).
        desired: Desired world pose of the EE now, shape (n, 7).
        planned: Desired world pose in `observation.HORIZON` seconds, shape (n, 7).
    """

    observation: Array
    base_pose: Array
    ee_pose: Array
    desired: Array
    planned: Array


class Policy(Protocol):
    """Moves the base."""

    def act(self, situation: Situation) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        ...


@dataclass(frozen=True)
class Network:
    """A multi-layer perceptron with ReLU between its layers and tanh at its end.

    Each row is computed by itself in a fixed order, so that an action does not depend on what
    else is in the batch.

    Attributes:
        scale: Factor on each observed number, shape (inputs,).
        weights: Of each layer, shape (inputs, outputs), float32.
        biases: Of each layer, shape (outputs,), float32.
    """

    scale: NDArray[np.float32]
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]

    def act(self, situation: Situation) -> Array:
        """Return base commands in [-1, 1], shape (n, actions)."""
        return self(situation.observation)

    def __call__(self, observation: Array) -> Array:
        """Return the network's output for observations of shape (n, inputs)."""
        values = np.ascontiguousarray(observation, dtype=np.float32) * self.scale
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            out = np.empty((len(values), len(bias)), dtype=np.float32)
            _layer(values, weight, bias, i < last, out)
            values = out
        return np.tanh(values).astype(np.float64)


@njit(cache=True, error_model="numpy")
def _layer(values, weight, bias, rectify, out):
    """Write values @ weight + bias, one row after the other, summed in the order of the inputs."""
    for i in range(len(values)):
        row = out[i]
        row[:] = bias
        for k in range(len(weight)):
            x = values[i, k]
            if x != 0.0:
                for j in range(len(row)):
                    row[j] += x * weight[k, j]
        if rectify:
            for j in range(len(row)):
                row[j] = max(row[j], np.float32(0.0))
