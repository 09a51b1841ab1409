"""What a base policy is, and the trained network that plays one without torch."""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from kinfeas import config
from kinfeas.drive import action_size
from kinfeas.errors import KinfeasError
from kinfeas.observation import scaled, size
from kinfeas.quantities import Count
from kinfeas.robots.robot import Robot
from kinfeas.spatial import Array
from kinfeas.storage.folders import find_folder

_WEIGHTS, _ABOUT, _FORMAT = "policy.safetensors", "policy.json", 1

# What reading files raises that are cut, foreign or made up.
_BROKEN = (OSError, SafetensorError, ValueError, KeyError, TypeError, RecursionError)


@dataclass(frozen=True)
class Situation:
    """All that a policy may look at, for n robots.

    Attributes:
        observation: What a learned policy sees, shape (n, 21 + j).
        base_pose: World pose of the base, shape (n, 7).
        ee_pose: Achieved world pose of the EE, shape (n, 7).
        desired: Desired world pose of the EE now, shape (n, 7).
        planned: Desired world pose in `observation.HORIZON` seconds, shape (n, 7). Where the motion
            is slowed down it is nearer than what the observation shows, which is always at full
            pace.
        demonstrated_base: World pose at which the base was demonstrated to be now, shape (n, 7);
            NaN where none was.
    """

    observation: Array
    base_pose: Array
    ee_pose: Array
    desired: Array
    planned: Array
    demonstrated_base: Array


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
        scale: Factor on each observed number before it is clipped, shape (inputs,), float32.
        weights: Of each layer, shape (inputs, outputs), float32.
        biases: Of each layer, shape (outputs,), float32.
    """

    scale: NDArray[np.float32]
    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]

    def act(self, situation: Situation) -> Array:
        """Return base commands in [-1, 1], shape (n, actions)."""
        return self(situation.observation)

    def __call__(self, seen: Array) -> Array:
        """Return the network's output for observations of shape (n, inputs)."""
        values = scaled(seen, self.scale)
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            out = np.empty((len(values), len(bias)), dtype=np.float32)
            _layer(values, weight, bias, i < last, out)
            values = out
        return np.tanh(values).astype(np.float64)


@dataclass(frozen=True)
class _About:
    """What has to be known of a network to read it.

    Attributes:
        format: Of its files.
        robot: Name of the robot that it was trained for.
        layers: How many it has.
    """

    format: Literal[1]
    robot: str
    layers: Count


def write_network(network: Network, folder: Path, robot: Robot, extra: dict[str, Any]) -> None:
    """Write a network as `policy.safetensors` and `policy.json` into `folder`.

    Args:
        network: What to write.
        folder: An existing folder.
        robot: Whom it was trained for.
        extra: Whatever else the JSON should tell: training configuration, success figures.
    """
    tensors = {"scale": network.scale}
    for i, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        tensors |= {f"weight.{i}": weight, f"bias.{i}": bias}
    contiguous = {key: np.ascontiguousarray(values) for key, values in tensors.items()}
    save_file(contiguous, folder / _WEIGHTS)
    about = {"format": _FORMAT, "robot": robot.name, "layers": len(network.weights), **extra}
    (folder / _ABOUT).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")


def policy_folder(folder: Path) -> Path:
    """Return where the policy of a training run (its best checkpoint) or of one checkpoint lies.

    Args:
        folder: `runs/NAME`, or a folder with `policy.safetensors` and `policy.json`.
    """
    best = find_folder(folder / "checkpoints" / "best")
    return best if best.is_dir() else find_folder(folder)


def read_network(folder: Path, robot: Robot) -> Network:
    """Return the network of a training run (its best checkpoint) or of one checkpoint.

    Args:
        folder: `runs/NAME`, or a folder with `policy.safetensors` and `policy.json`.
        robot: Whom it is to drive.

    Raises:
        KinfeasError: If there is no policy, or a broken one, or one for another robot.
    """
    place = policy_folder(folder)
    try:
        about = _read_about(place / _ABOUT)
        tensors = load_file(place / _WEIGHTS)
        network = Network(
            tensors["scale"],
            tuple(tensors[f"weight.{i}"] for i in range(about.layers)),
            tuple(tensors[f"bias.{i}"] for i in range(about.layers)),
        )
    except FileNotFoundError as error:
        raise KinfeasError(
            f"{folder}: not a training run or checkpoint: there is no {error.filename or _WEIGHTS}"
        ) from error
    except _BROKEN as error:
        raise KinfeasError(f"{place}: broken policy: {error}") from error
    _check_network(network, place)
    wanted = (size(len(robot.arm)), action_size(robot.base))
    found = (len(network.scale), len(network.biases[-1]))
    if about.robot != robot.name or found != wanted:
        raise KinfeasError(
            f"{place}: a policy for robot {about.robot!r} with {found[0]} observed numbers and "
            f"{found[1]} actions, but robot {robot.name!r} has {wanted[0]} and {wanted[1]}"
        )
    return network


def _read_about(path: Path) -> _About:
    about = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(about, dict):
        about = {one.name: about[one.name] for one in fields(_About) if one.name in about}
    return config.from_mapping(_About, about, path.name)


def _check_network(network: Network, place: Path) -> None:
    scale = network.scale
    if scale.ndim != 1 or scale.dtype != np.float32 or not np.isfinite(scale).all():
        raise KinfeasError(
            f"{place}: broken policy: its scale must be finite numbers of 32 bits in one row"
        )
    width = len(scale)
    for weight, bias in zip(network.weights, network.biases, strict=True):
        fits = weight.ndim == 2 and weight.shape == (width, *bias.shape)
        finite = np.isfinite(weight).all() and np.isfinite(bias).all()
        if not (fits and finite and weight.dtype == bias.dtype == np.float32):
            raise KinfeasError(f"{place}: broken policy: its layers do not fit or are not finite")
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
