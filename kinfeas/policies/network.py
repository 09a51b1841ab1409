"""Trained networks of base policies, evaluated without torch."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from kinfeas.control.observation import (
    ACTION,
    OBSERVATION,
    check_terms,
    describe_action,
    describe_observation,
    scale,
    scaled,
    size,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Observation
from kinfeas.core.spatial import Array
from kinfeas.io.files import reading, write_folder
from kinfeas.io.policy_metadata import Trained, policy_folder, read_trained, write_trained
from kinfeas.kinematics.drive import command_size
from kinfeas.robots.robot import Robot, fingerprint

WEIGHTS = "policy.safetensors"

# Exceptions of truncated or foreign files, and of types that NumPy lacks.
_BROKEN = (OSError, SafetensorError, ValueError, KeyError, TypeError, AttributeError)


@dataclass(frozen=True)
class Network:
    """A multi-layer perceptron with ReLU between its layers and tanh at its end.

    Each row is computed by itself in a fixed order, so that actions do not depend on the batch.

    Attributes:
        scale: Factor on each number of the observation before clipping, shape (inputs,), float32.
        weights: Weights of each layer, shape (inputs, outputs), float32.
        biases: Biases of each layer, shape (outputs,), float32.
        observation_terms: Names of its observation terms, in order.
    """

    scale: NDArray[np.float32]
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    observation_terms: tuple[str, ...] = OBSERVATION

    def act(self, observation: Observation) -> Array:
        """Return actions in [-1, 1], shape (n, actions)."""
        return self(observation.values)

    def __call__(self, observation: Array) -> Array:
        """Return the network's output for observations of shape (n, inputs)."""
        values = scaled(observation, self.scale)
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            out = np.empty((len(values), len(bias)), dtype=np.float32)
            _layer(values, weight, bias, i < last, out)
            values = out
        return np.tanh(values).astype(np.float64)

    def widened(self, robot: Robot, terms: Sequence[str]) -> "Network":
        """Return a network with more observation terms, which have no effect yet.

        Raises:
            KinfeasError: If the first terms are not those of this network.
        """
        begin = tuple(terms[: len(self.observation_terms)])
        if begin != self.observation_terms:
            raise KinfeasError(f"the policy has the terms {self.observation_terms}, not {begin}")
        first, *others = self.weights
        added = size(robot, terms) - len(self.scale)
        weights = (np.pad(first, ((0, added), (0, 0))), *others)
        return Network(scale(robot, terms).astype(np.float32), weights, self.biases, tuple(terms))

    def equals(self, other: "Network") -> bool:
        """Return whether both networks have equal weights and biases."""
        pairs = zip((*self.weights, *self.biases), (*other.weights, *other.biases), strict=True)
        return all(np.array_equal(one, another) for one, another in pairs)


def write_network(network: Network, folder: Path, robot: Robot, known: Mapping[str, Any]) -> None:
    """Write a network as `policy.safetensors` and `policy.json` into an existing folder.

    `known` has more fields of `Trained`: settings, steps, metrics.
    """
    tensors = {"scale": network.scale}
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tensors |= {f"weight.{i}": weight, f"bias.{i}": bias}
    contiguous = {key: np.ascontiguousarray(values) for key, values in tensors.items()}
    save_file(contiguous, folder / WEIGHTS)
    trained = Trained(
        robot=robot.name,
        layers=len(network.weights),
        kinematics=fingerprint(robot),
        observation=describe_observation(robot, network.observation_terms),
        action=(describe_action(robot),),
        **known,
    )
    write_trained(trained, folder)


def copy_network(source: Path, trained: Trained, target: Path) -> None:
    """Write the network of the folder `source` into the folder `target`, with its own metadata."""

    def fill(folder: Path) -> None:
        shutil.copyfile(source / WEIGHTS, folder / WEIGHTS)
        write_trained(trained, folder)

    write_folder(target, fill)


def read_network(folder: Path, robot: Robot) -> Network:
    """Return the network of a training run (its best checkpoint) or of one checkpoint.

    Raises:
        KinfeasError: If there is no policy, or it is broken or for another robot or other
            kinematics.
    """
    place = policy_folder(folder)
    trained = read_trained(place)
    try:
        with reading(place / WEIGHTS):
            tensors = load_file(place / WEIGHTS)
        network = Network(
            tensors["scale"],
            tuple(tensors[f"weight.{i}"] for i in range(trained.layers)),
            tuple(tensors[f"bias.{i}"] for i in range(trained.layers)),
            check_terms([term.name for term in trained.observation], f"{place}: observation"),
        )
    except KinfeasError:
        raise
    except _BROKEN as error:
        raise KinfeasError(f"{place}: broken policy: {error}") from error
    check_network(network, str(place))
    _check_robot(network, trained, robot, place)
    return network


def _check_robot(network: Network, trained: Trained, robot: Robot, place: Path) -> None:
    wanted = (
        size(robot, network.observation_terms),
        command_size(robot.base),
    )
    found = (len(network.scale), len(network.biases[-1]))
    if (names := [term.name for term in trained.action]) != [ACTION]:
        raise KinfeasError(f"{place}: action must be [{ACTION}], not {names}")
    if trained.robot != robot.name or found != wanted:
        raise KinfeasError(
            f"{place}: a policy for robot {trained.robot!r} with (inputs, actions) {found}, "
            f"not for {robot.name!r} with {wanted}"
        )
    if trained.kinematics not in (None, fingerprint(robot)):
        raise KinfeasError(
            f"{place}: trained with other kinematics of {robot.name!r}: joints, limits, EE frame, "
            "or the base's drive or speed"
        )


def check_network(network: Network, source: str) -> None:
    """Raise KinfeasError, which names the source, unless the layers fit and are finite."""
    scale = network.scale
    if scale.ndim != 1 or scale.dtype != np.float32 or not np.isfinite(scale).all():
        raise KinfeasError(f"{source}: broken policy: scale must be a row of finite float32")
    width = len(scale)
    for weight, bias in zip(network.weights, network.biases, strict=True):
        fits = weight.ndim == 2 and weight.shape == (width, *bias.shape)
        finite = np.isfinite(weight).all() and np.isfinite(bias).all()
        if not (fits and finite and weight.dtype == bias.dtype == np.float32):
            raise KinfeasError(f"{source}: broken policy: its layers do not fit or are not finite")
        width = len(bias)


@njit(cache=True, error_model="numpy")
def _layer(values, weight, bias, rectify, out):
    """Write values @ weight + bias, one row after the other, summed in the order of the inputs."""
    for i in range(len(values)):
        row = out[i]
        for j in range(len(row)):
            row[j] = bias[j]
        for k in range(len(weight)):
            x = values[i, k]
            if x != 0.0:
                for j in range(len(row)):
                    row[j] += x * weight[k, j]
        if rectify:
            for j in range(len(row)):
                row[j] = max(row[j], np.float32(0.0))
