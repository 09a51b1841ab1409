"""Policies in one self-describing ONNX file, evaluated with onnxruntime.

Each field of `PolicyMetadata` is one metadata entry `kinfeas.FIELD` of the file, as JSON. The last
entry, `kinfeas.digest`, is the SHA-256 hash of all bytes before it.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas import config
from kinfeas.control.observation import (
    ACTIONS,
    HORIZON,
    TERMS,
    check_terms,
    describe_action,
    describe_observation,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import PolicyInput, TermInfo
from kinfeas.core.spatial import Array
from kinfeas.io.files import read_file
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

    period: float | None
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

    @property
    def trained_with(self) -> str:
        """Name or path of the robot in the configuration of the training."""
        settings = self.training.get("config")
        known = settings if isinstance(settings, dict) else {}
        return str(known.get("robot", self.robot.name))


class OnnxPolicy:
    """A policy evaluated with onnxruntime in one thread.

    Rows are evaluated one at a time, because onnxruntime rounds batches differently.

    Args:
        content: Bytes of a file written by `kinfeas export`.

    Attributes:
        metadata: Description of the policy.
        observation_terms: Names of its observation terms, in order.
        action_terms: Names of its action terms, in order.

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
        self._content, self._session = content, _session(content)
        self.metadata = _metadata(self._session.get_modelmeta().custom_metadata_map)
        self.observation_terms = check_terms(
            self.metadata.observation, tuple(TERMS), "its observation"
        )
        self.action_terms = check_terms(self.metadata.action, ACTIONS, "its action")
        self._actions = sum(term.size for term in self.metadata.action)
        self._check_sizes()
        self._check_golden_pairs()

    def act(self, policy_input: PolicyInput) -> Array:
        """Return actions in [-1, 1], shape (n, actions)."""
        return self(policy_input.observation)

    def __call__(self, observation: Array) -> Array:
        """Return the actions, shape (n, actions), for observations of shape (n, inputs).

        Rows with a non-finite entry get NaN; clipping inside the graph would hide it.
        """
        values = np.ascontiguousarray(observation, dtype=np.float32)
        finite = np.logical_and.reduce(np.isfinite(values), axis=1)
        action = np.full((len(values), self._actions), np.nan)
        for i in range(len(values)):
            if finite[i]:
                action[i] = self._session.run((OUTPUT,), {INPUT: values[i : i + 1]})[0]
        return action

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor call for worker processes."""
        return OnnxPolicy, (self._content,)

    def check_robot(self, robot: Robot) -> None:
        """Check that the policy was trained for a robot with these kinematics."""
        metadata, wanted = self.metadata, describe_robot(robot)
        found = metadata.robot
        if found.name != wanted.name:
            raise KinfeasError(f"a policy for robot {found.name!r}, not for {wanted.name!r}")
        if found.kinematics != wanted.kinematics:
            raise KinfeasError(
                f"the kinematics of robot {robot.name!r} changed since the training: "
                f"{wanted.kinematics[:15]!r} here, {found.kinematics[:15]!r} in the file"
            )
        observation = describe_observation(robot, self.observation_terms)
        action = describe_action(robot, self.action_terms)
        here = wanted, observation, action, HORIZON
        if here != (found, metadata.observation, metadata.action, metadata.control.horizon):
            raise KinfeasError("its observation or action differs from this version's of kinfeas")

    def _check_sizes(self) -> None:
        ends = (*self._session.get_inputs(), *self._session.get_outputs())
        found = [(end.name, end.type, end.shape) for end in ends]
        inputs = sum(term.size for term in self.metadata.observation)
        sizes = {INPUT: inputs, OUTPUT: self._actions}
        wanted = [(name, "tensor(float)", [BATCH, size]) for name, size in sizes.items()]
        if found != wanted:
            raise KinfeasError(f"its graph has {found}, its metadata describe {wanted}")

    def _check_golden_pairs(self) -> None:
        golden = self.metadata.golden
        deviation = np.abs(self(np.array(golden.observation)) - np.array(golden.action)).max()
        if not deviation <= TOLERANCE:
            raise KinfeasError(f"its golden pairs are off by {deviation:.2g} > {TOLERANCE:g}")


def read_policy_file(path: Path, robot: Robot | None) -> OnnxPolicy:
    """Return the policy of a file written by `kinfeas export`; without a robot, to inspect it.

    Raises:
        KinfeasError: As `OnnxPolicy`, or if the policy is for another robot or other kinematics.
    """
    content = read_file(path, MAX_BYTES)
    try:
        policy = OnnxPolicy(content)
        if robot is not None:
            policy.check_robot(robot)
    except KinfeasError as error:
        raise KinfeasError(f"{path}: {error}") from error
    return policy


def digest_entry(body: bytes) -> bytes:
    """Return the serialized metadata entry with the digest of the bytes before it."""
    return _DIGEST_ENTRY + hashlib.sha256(body).hexdigest().encode() + b'"'


def describe_robot(robot: Robot) -> RobotInfo:
    """Return the description of a robot for the metadata."""
    base = robot.base
    return RobotInfo(robot.name, fingerprint(robot), robot.ee_frame, base.frame, base.drive)


def _session(content: bytes) -> Any:
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as errors

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except (errors.Fail, errors.InvalidGraph, errors.InvalidProtobuf, errors.NotImplemented) as e:
        reason = " ".join(str(e).split())[:200]
        raise KinfeasError(f"onnxruntime {onnxruntime.__version__}: {reason}") from e


def _metadata(entries: dict[str, str]) -> PolicyMetadata:
    if (schema := entries.pop(f"{PREFIX}schema", None)) != str(SCHEMA):
        raise KinfeasError(f"its schema is {schema}; this version reads schema {SCHEMA}")
    del entries[f"{PREFIX}digest"]
    try:
        data = {key.removeprefix(PREFIX): json.loads(value) for key, value in entries.items()}
    except ValueError as error:
        raise KinfeasError(f"its metadata are not JSON: {error}") from error
    return config.from_mapping(PolicyMetadata, data, "its metadata")
