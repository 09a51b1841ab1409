"""Policies in one ONNX file, as `kinfeas export` writes them: checked, and run on onnxruntime."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.control.observation import HORIZON
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array
from kinfeas.io.files import read_file
from kinfeas.policies import onnx_metadata
from kinfeas.policies.onnx_graph import INPUT, OUTPUT, check_graph
from kinfeas.policies.onnx_metadata import About
from kinfeas.robots.robot import Robot

TOLERANCE = 1e-5
"""How far the actions of a golden pair, which lie in [-1, 1], may be off."""

MAX_BYTES = 20_000_000
"""More than any policy; it keeps a wrong path from filling the memory."""


class PolicyFile:
    """A policy that runs on onnxruntime, in one thread.

    Each row is run by itself, as on a robot: onnxruntime rounds a batch otherwise than its rows.

    Attributes:
        about: What the file says of itself.
    """

    def __init__(self, content: bytes, about: About) -> None:
        """Start onnxruntime on the bytes of an ONNX file that `parse_policy_file` has checked.

        Raises:
            KinfeasError: If onnxruntime cannot run it.
        """
        self.about = about
        self._content, self._session = content, _start(content)

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, actions)."""
        return self(policy_input.observation)

    def __call__(self, seen: Array) -> Array:
        """Return the actions, shape (n, actions), for observations of shape (n, inputs).

        A row that is not finite gets NaN, rather than what clipping makes of it.
        """
        values = np.ascontiguousarray(seen, dtype=np.float32)
        finite = np.logical_and.reduce(np.isfinite(values), axis=1)
        action = np.full((len(values), len(self.about.action)), np.nan)
        for i in range(len(values)):
            if finite[i]:
                action[i] = self._session.run((OUTPUT,), {INPUT: values[i : i + 1]})[0]
        return action

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how worker processes make the same policy again."""
        return PolicyFile, (self._content, self.about)


def read_policy_file(path: Path, robot: Robot | None) -> PolicyFile:
    """Return the policy that `kinfeas export` wrote into one ONNX file.

    Args:
        path: The file.
        robot: Whom it is to drive; None for a look at the file, which drives nobody.

    Raises:
        KinfeasError: If it is no such file, is damaged or changed, answers its golden pairs
            wrongly, or is for another robot or other kinematics.
    """
    content = read_file(path, MAX_BYTES)
    with _naming(path):
        return parse_policy_file(content, robot)


def read_about(path: Path) -> About:
    """Return what an ONNX file says of itself, without onnxruntime.

    Raises:
        KinfeasError: If `kinfeas export` did not write it, or it is damaged or changed.
    """
    content = read_file(path, MAX_BYTES)
    with _naming(path):
        return _check(content)


def parse_policy_file(content: bytes, robot: Robot | None) -> PolicyFile:
    """Return the policy that the bytes of a file hold; the rest as in `read_policy_file`."""
    about = _check(content)
    if robot is not None:
        _check_robot(about, robot)
    policy = PolicyFile(content, about)
    _check_golden(policy)
    return policy


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let errors begin with the file that they are about."""
    try:
        yield
    except KinfeasError as error:
        raise KinfeasError(f"{path}: {error}") from error


def _check(content: bytes) -> About:
    """Return what a file says of itself, after all checks that need no onnxruntime."""
    metadata = onnx_metadata.read_metadata(content)
    onnx_metadata.check_schema(metadata)
    inputs, outputs = check_graph(content)
    if metadata.get(onnx_metadata.DIGEST) != onnx_metadata.digest(content):
        raise KinfeasError("it was changed after its export: its digest does not fit")
    about = onnx_metadata.from_metadata(metadata)
    described = sum(field.size for field in about.observation), len(about.action)
    if described != (inputs, outputs):
        raise KinfeasError(
            f"its network has {inputs} inputs and {outputs} outputs, "
            f"but its metadata describes {described[0]} and {described[1]}"
        )
    seen, action = about.golden.observation, about.golden.action
    sizes = {(len(one), len(answer)) for one, answer in zip(seen, action, strict=False)}
    if len(seen) != len(action) or sizes != {described}:
        raise KinfeasError("its golden pairs are missing or of the wrong size")
    return about


def _check_robot(about: About, robot: Robot) -> None:
    wanted, found = onnx_metadata.describe_robot(robot), about.robot
    if found.name != wanted.name:
        raise KinfeasError(f"a policy for robot {found.name!r}, not for {wanted.name!r}")
    if found.kinematics != wanted.kinematics:
        raise KinfeasError(
            f"the kinematics of robot {robot.name!r} are not those that the policy was trained "
            f"with: {wanted.kinematics[:15]!r}... here, {found.kinematics[:15]!r}... there"
        )
    described = (found, about.observation, about.action, about.control.horizon)
    here = (
        wanted,
        onnx_metadata.describe_observation(robot),
        onnx_metadata.describe_action(robot),
        HORIZON,
    )
    if described != here:
        raise KinfeasError("it sees or commands other things than this version of kinfeas does")


def _start(content: bytes) -> Any:
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as errors

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except (errors.Fail, errors.InvalidGraph, errors.InvalidProtobuf, errors.NotImplemented) as e:
        reason = " ".join(str(e).split())[:200]
        raise KinfeasError(f"onnxruntime {onnxruntime.__version__} refuses it: {reason}") from e


def _check_golden(policy: PolicyFile) -> None:
    golden = policy.about.golden
    off = np.abs(policy(np.array(golden.observation)) - np.array(golden.action)).max()
    if not off <= TOLERANCE:
        raise KinfeasError(
            f"it answers its golden pairs wrongly, {off:.2g} off where {TOLERANCE:g} is allowed: "
            "its weights were changed, or this machine computes otherwise"
        )
