"""Policies in one self-describing ONNX file, which is read without ONNX libraries.

Each field of `PolicyMetadata` is one metadata entry `kinfeas.FIELD` of the file, as JSON. The last
entry, `kinfeas.digest`, is the SHA-256 hash of all bytes before it.
"""

import hashlib
import json
from collections import defaultdict
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas import config
from kinfeas.control.observation import CLIP, HORIZON
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import read_file
from kinfeas.core.policy import Observation, TermInfo
from kinfeas.core.quantities import ControlPeriod
from kinfeas.core.spatial import Array
from kinfeas.policies.network import Network, check_network, check_robot
from kinfeas.robots.robot import Robot, fingerprint

SCHEMA, PREFIX = 1, "kinfeas."
"""Version of the metadata and of the graph, and start of the metadata keys."""

INPUT, OUTPUT, BATCH = "observation", "action", "batch"
"""Names of the graph's input and output, and of their first axis."""

TOLERANCE = 1e-5
"""Largest allowed difference of an action in [-1, 1] from the training policy's."""

MAX_BYTES = 20_000_000

# The serialized `metadata_props` entry up to the 64 hexadecimal digits and the closing quote.
_DIGEST_ENTRY = b'r\x5b\n\x0ekinfeas.digest\x12\x49"sha256:'
_DIGEST_LENGTH = len(_DIGEST_ENTRY) + 65


@dataclass(frozen=True)
class RobotInfo:
    """The robot that a policy controls; `kinematics` is its fingerprint."""

    name: str
    kinematics: str
    ee_frame: str
    base_frame: str
    drive: str


@dataclass(frozen=True)
class Control:
    """Control period of the training (None if unknown), and `observation.HORIZON`, seconds."""

    period: ControlPeriod | None
    horizon: float


@dataclass(frozen=True)
class GoldenPairs:
    """Observations and the training policy's actions, one row each."""

    observation: tuple[tuple[float, ...], ...]
    action: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class PolicyMetadata:
    """Description of an exported policy, written by kinfeas of `version`.

    `training` has the configuration, seed and steps of the run, `success` evaluation metrics by
    kind, `golden` pairs that the loaded policy has to reproduce.
    """

    version: str
    robot: RobotInfo
    observation: tuple[TermInfo, ...]
    action: tuple[TermInfo, ...]
    control: Control
    training: dict[str, object]
    success: dict[str, object]
    golden: GoldenPairs


class OnnxPolicy:
    """A policy of an ONNX file, whose actions equal those of the trained network to the bit.

    Args:
        content: Bytes of a file written by `kinfeas export`.

    Attributes:
        metadata: Description of the policy.
        observation_terms: Names of its observation terms, in order.
        robot: Robot that it was read for, if any.

    Raises:
        KinfeasError: If `kinfeas export` did not write the bytes, they were changed, or the
            policy does not reproduce its golden pairs.
    """

    def __init__(self, content: bytes) -> None:
        body, entry = content[:-_DIGEST_LENGTH], content[-_DIGEST_LENGTH:]
        if not entry.startswith(_DIGEST_ENTRY):
            raise KinfeasError("truncated, or not written by `kinfeas export`")
        if entry != digest_entry(body):
            raise KinfeasError("changed after its export: the digest does not match")
        entries, self._network = _read_model(content)
        self.metadata = metadata = _metadata(entries)
        check_network(self._network, metadata.observation, metadata.action, "its graph")
        self.observation_terms = tuple(term.name for term in metadata.observation)
        self.robot: Robot | None = None
        golden = metadata.golden
        try:
            actions = self(np.array(golden.observation))
            deviation = np.abs(actions - np.array(golden.action)).max()
        except (ValueError, IndexError) as error:
            raise KinfeasError(f"its golden pairs do not fit its graph: {error}") from error
        if not deviation <= TOLERANCE:
            raise KinfeasError(f"its golden pairs are off by {deviation:.2g} > {TOLERANCE:g}")

    def act(self, observation: Observation) -> Array:
        """Return actions in [-1, 1], shape (n, actions)."""
        return self(observation.values)

    def __call__(self, observation: Array) -> Array:
        """Return the actions, shape (n, actions), for observations of shape (n, inputs).

        Rows with a non-finite entry get NaN; clipping inside the network would hide it.
        """
        action = self._network(observation)
        finite = np.isfinite(observation.astype(np.float32)).all(axis=1)
        action[~finite] = np.nan
        return action


def read_policy_file(path: str | Path, robot: Robot | None) -> OnnxPolicy:
    """Return the policy of a file written by `kinfeas export`; without a robot, to inspect it.

    Raises:
        KinfeasError: As `OnnxPolicy`, or if the policy is for another robot or other kinematics.
    """
    content = read_file(Path(path), MAX_BYTES)
    try:
        policy = OnnxPolicy(content)
    except KinfeasError as error:
        raise KinfeasError(f"{path}: {error}") from error
    policy.robot = robot
    if robot is not None:
        info, metadata = policy.metadata.robot, policy.metadata
        terms = metadata.observation, metadata.action
        check_robot(robot, info.name, info.kinematics, *terms, str(path))
        if metadata.control.horizon != HORIZON:
            raise KinfeasError(f"{path}: its horizon of observation or action is not {HORIZON} s")
    return policy


def digest_entry(body: bytes) -> bytes:
    """Return the serialized metadata entry with the digest of the bytes before it."""
    return _DIGEST_ENTRY + hashlib.sha256(body).hexdigest().encode() + b'"'


def describe_robot(robot: Robot) -> RobotInfo:
    """Return the description of a robot for the metadata."""
    base = robot.base
    return RobotInfo(robot.name, fingerprint(robot), robot.ee_frame, base.frame, base.drive)


def graph_nodes(layers: int) -> list[tuple[str, list[str], str]]:
    """Return operator, inputs and output of each node of the graph of a network."""
    steps = [("Mul", ["scale"]), ("Clip", ["low", "high"])]
    for i in range(layers):
        steps += [("Gemm", [f"weight_{i}", f"bias_{i}"]), ("Relu", [])]
    steps[-1] = ("Tanh", [])
    values = [INPUT, *(f"value_{i}" for i in range(len(steps) - 1)), OUTPUT]
    return [
        (operator, [values[i], *constants], values[i + 1])
        for i, (operator, constants) in enumerate(steps)
    ]


def _read_model(content: bytes) -> tuple[dict[str, str], Network]:
    """Return metadata and network of a file; the integer keys are field numbers of onnx.proto."""
    try:
        model = _fields(content)
        pairs = [_fields(entry) for entry in model[14]]
        graph, tensors = _fields(model[7][0]), {}
        for tensor in map(_fields, graph[5]):
            numbers = np.frombuffer(tensor[9][0], "<f4").astype(np.float32)
            tensors[tensor[8][0].decode()] = numbers.reshape(tensor[1])
        layers = range((len(tensors) - 3) // 2)
        nodes = [
            {1: [name.encode() for name in inputs], 2: [output.encode()], 4: [operator.encode()]}
            for operator, inputs, output in graph_nodes(len(layers))
        ]
        if not layers or [_fields(node) for node in graph[1]] != nodes:
            raise KinfeasError("its graph is not that of a policy")
        if (float(tensors["low"]), float(tensors["high"])) != (-CLIP, CLIP):
            raise KinfeasError("its graph clips observations elsewhere")
        weights, biases = (
            tuple(tensors[f"{name}_{i}"] for i in layers) for name in ("weight", "bias")
        )
        network = Network(tensors["scale"], weights, biases)
        return {pair[1][0].decode(): pair[2][0].decode() for pair in pairs}, network
    except (ValueError, LookupError, AttributeError, TypeError, OverflowError) as error:
        raise KinfeasError(f"its graph cannot be read: {error}") from error


def _fields(message: bytes) -> dict[int, list[Any]]:
    """Return the values of a protocol buffer by field number: integers, or bytes of all others."""
    stream, fields = BytesIO(message), defaultdict[int, list[Any]](list)

    def integer() -> int:
        value = 0
        for shift in range(0, 70, 7):  # 64 bits
            (byte,) = stream.read(1)
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("an integer has more than 10 bytes")

    while stream.tell() < len(message):
        field, kind = divmod(integer(), 8)
        if kind not in (0, 2):
            raise ValueError(f"field {field} is of kind {kind}")
        value = integer()
        fields[field].append(stream.read(value) if kind else value)
    return fields


def _metadata(entries: dict[str, str]) -> PolicyMetadata:
    if (schema := entries.pop(f"{PREFIX}schema", None)) != str(SCHEMA):
        raise KinfeasError(f"its schema is {schema}; this version reads schema {SCHEMA}")
    entries.pop(f"{PREFIX}digest", None)
    try:
        data = {key.removeprefix(PREFIX): json.loads(value) for key, value in entries.items()}
    except (ValueError, RecursionError) as error:
        raise KinfeasError(f"its metadata are not JSON: {error}") from error
    return config.from_mapping(PolicyMetadata, data, "its metadata")
