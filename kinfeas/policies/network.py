"""Trained networks of base policies, evaluated without torch."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from safetensors.numpy import save

from kinfeas.control.observation import (
    OBSERVATION,
    TERMS,
    describe_action,
    describe_observation,
    scale,
    scaled,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import file_hash, write_folder
from kinfeas.core.policy import Observation, TermInfo
from kinfeas.core.spatial import Array
from kinfeas.io.policy_metadata import WEIGHTS, Trained, read_policy, write_trained
from kinfeas.robots.robot import Robot, check_same_robot, fingerprint


@dataclass(frozen=True)
class Network:
    """A multi-layer perceptron with ReLU between its layers and tanh at its end.

    Each row is computed by itself in a fixed order, so that actions do not depend on the batch.
    """

    # factor on each number of the observation before clipping, shape (inputs,), float32
    scale: NDArray[np.float32]
    # weights of each layer, shape (inputs, outputs), float32
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]  # biases of each layer, shape (outputs,), float32
    observation_terms: tuple[str, ...] = OBSERVATION  # names of its observation terms, in order
    robot: Robot | None = None  # robot that it was read for, if any

    def __repr__(self) -> str:
        sizes = len(self.scale), *map(len, self.biases)
        return f"Network({' -> '.join(map(str, sizes))})"

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
        added = scale(robot, terms)[len(self.scale) :].astype(np.float32)
        weights = (np.pad(first, ((0, len(added)), (0, 0))), *others)
        scales = np.concatenate([self.scale, added])
        return Network(scales, weights, self.biases, tuple(terms))

    def equals(self, other: "Network") -> bool:
        """Return whether both networks have equal weights and biases."""
        pairs = zip((*self.weights, *self.biases), (*other.weights, *other.biases), strict=True)
        return all(np.array_equal(own, another) for own, another in pairs)


def write_network(network: Network, folder: Path, robot: Robot, about: Mapping[str, Any]) -> None:
    """Write a network as `policy.safetensors` and `policy.json` into an existing folder.

    `about` has further fields of `Trained`, such as `config`, `steps` and metrics.
    """
    tensors = {"scale": network.scale}
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tensors |= {f"weight.{i}": weight, f"bias.{i}": bias}
    contiguous = {key: np.ascontiguousarray(values) for key, values in tensors.items()}
    (folder / WEIGHTS).write_bytes(save(contiguous))  # `save_file` writes with mode 0600
    trained = Trained(
        robot=robot.name, layers=len(network.weights), kinematics=fingerprint(robot),
        weights=file_hash(folder / WEIGHTS),
        observation=describe_observation(robot, network.observation_terms),
        action=(describe_action(robot),), **about,
    )  # fmt: skip
    write_trained(trained, folder)


def copy_network(source: Path, trained: Trained, target: Path) -> None:
    """Copy the weights in the folder `source` to the folder `target`, with other metadata."""

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
    tensors, trained = read_policy(folder)
    layers = range(trained.layers)
    try:
        weights = tuple(tensors[f"weight.{i}"] for i in layers)
        biases = tuple(tensors[f"bias.{i}"] for i in layers)
        terms = tuple(term.name for term in trained.observation)
        network = Network(tensors["scale"], weights, biases, terms, robot)
    except KeyError as error:
        raise KinfeasError(f"{folder}: broken policy: there is no tensor {error}") from error
    check_network(network, trained.observation, trained.action, str(folder))
    terms_of_file = trained.observation, trained.action
    check_robot(robot, trained.robot, trained.kinematics, *terms_of_file, str(folder))
    return network


def check_robot(
    robot: Robot, name: str, kinematics: str | None, observation: tuple[TermInfo, ...],
    action: tuple[TermInfo, ...], source: str,
) -> None:  # fmt: skip
    """Raise KinfeasError unless a policy of this description was trained for a robot.

    `kinematics` is the fingerprint of the robot of the training, None if unknown.
    """
    check_same_robot(robot, name, kinematics, source)
    described, names = (*observation, *action), [t.name for t in observation if t.name in TERMS]
    expected = (*describe_observation(robot, names), describe_action(robot))
    own, ours = ([(t.name, t.size, t.scale) for t in terms] for terms in (described, expected))
    if own != ours:
        entry, other = next(pair for pair in zip_longest(own, ours) if pair[0] != pair[1])
        raise KinfeasError(
            f"{source}: name, size and scale of an observation or action are {entry}, those of "
            f"{robot.name!r} in this version of kinfeas {other}"
        )


def check_network(
    network: Network, observation: Sequence[TermInfo], action: Sequence[TermInfo], source: str
) -> None:
    """Raise KinfeasError unless the layers fit each other and the description, and are finite."""
    width = sum(term.size for term in observation)
    arrays = (network.scale, *network.weights, *network.biases)
    fits = network.scale.shape == (width,)
    for weight, bias in zip(network.weights, network.biases, strict=True):
        fits &= bias.ndim == 1 and weight.shape == (width, *bias.shape)
        width = bias.size
    fits &= width == sum(term.size for term in action)
    if not fits or not all(a.dtype == np.float32 and np.isfinite(a).all() for a in arrays):
        raise KinfeasError(
            f"{source}: broken policy: layers must be finite float32 and fit observation, action "
            "and each other"
        )


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
