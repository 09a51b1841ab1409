"""Robots and policies by name or path, and policies as ONNX files."""

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from kinfeas.api import DEFAULT_ROBOT, Name
from kinfeas.config import PluginSpec, registry, to_mapping, validated
from kinfeas.control.assemble import read_sim2real
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import is_path
from kinfeas.core.policy import Policy
from kinfeas.io.policy_metadata import read_trained
from kinfeas.policies import loading
from kinfeas.policies.onnx_policy import OnnxPolicy, PolicyMetadata, read_policy_file
from kinfeas.robots import loading as robots
from kinfeas.robots.robot import Robot

Adapters = Name | Sequence[str | Mapping[str, object]]
"""List of adapters by name or YAML file, or its entries: names, or mappings with `name`."""


def load_robot(robot: Name | Robot) -> Robot:
    """Return a robot by its name or folder; a loaded robot is returned unchanged.

    Raises:
        KinfeasError: If there is no such robot, or a file is invalid.
    """
    return robot if isinstance(robot, Robot) else robots.load_robot(text_of(robot, "robot"))


def load_policy(policy: Name, *, robot: Name | None = None) -> Policy:
    """Return a policy, whose `act` returns base commands of shape (n, action size), in [-1, 1].

    Example: `kinfeas.load_policy("pretrained", robot="tiago").act`

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    return loading.load_policy(text_of(policy, "policy"), load_robot(robot or robot_of(policy)))


@dataclass(frozen=True)
class PolicyFile:
    """An exported policy."""

    path: Path  # its file
    bytes: int  # size of the file
    metadata: PolicyMetadata = field(repr=False)  # description of the policy
    # largest deviation of its actions from the trained policy's; None if not measured
    parity: float | None = None
    robot: str | None = None  # robot that it was compared with, by name or path

    def facts(self) -> dict[str, object]:
        """Return the description as plain data."""
        parity = {} if self.parity is None else {"parity": self.parity}
        return {"file": self.path.name, "bytes": self.bytes, **to_mapping(self.metadata), **parity}


def export(policy: Name, out: Name, *, robot: Name | None = None) -> PolicyFile:
    """Write a trained policy as an ONNX file and return its description.

    Example: `kinfeas.export("runs/pr2", "pr2.onnx").parity`

    The policy is a run, a checkpoint or `pretrained`.

    Raises:
        KinfeasError: If the policy is not a trained one or for another robot, or the file cannot
            be written.
    """
    name, path = text_of(policy, "policy"), Path(text_of(out, "out"))
    if path.suffix != ".onnx":
        raise KinfeasError(f"{path}: must end in .onnx")
    model = load_robot(robot or robot_of(name))
    folder = loading.trained_folder(name, model)
    if not name or not folder.is_dir():
        raise KinfeasError(f"policy {name!r} is not a run, a checkpoint or pretrained")
    from kinfeas.policies.export import export as run

    return _file(path, *run(folder, model, path))


def check_export(path: Name, *, robot: Name | None = None) -> PolicyFile:
    """Return the description of a valid ONNX file, compared with a robot.

    By default that is the installed robot with the name in the file, if there is one.

    Raises:
        KinfeasError: If the file is no valid policy, or for another robot.
    """
    policy = read_policy_file(path, None)
    if robot is None and policy.metadata.robot.name in registry.names("kinfeas.robots"):
        robot = policy.metadata.robot.name
    if robot is not None:
        policy = read_policy_file(path, load_robot(robot))
    return _file(Path(path), policy, robot=robot)


def _file(
    path: Path, policy: OnnxPolicy, parity: float | None = None, robot: Name | None = None
) -> PolicyFile:
    compared = None if robot is None else str(robot)
    return PolicyFile(path, path.stat().st_size, policy.metadata, parity, compared)


def robot_of(policy: Name | None) -> str:
    """Return the robot that a policy was trained for, by name or path; PR2 for other policies."""
    path = Path(text_of(policy or "", "policy"))
    if not policy or str(policy) in registry.names(loading.GROUP) or not path.exists():
        return DEFAULT_ROBOT
    if str(policy) in loading.trained_policies(load_robot(DEFAULT_ROBOT)):
        return DEFAULT_ROBOT
    settings: object
    if path.is_dir():
        trained = read_trained(path)
        settings, robot = trained.config, trained.robot
    else:
        metadata = read_policy_file(path, None).metadata
        settings, robot = metadata.training.get("config"), metadata.robot.name
    robot = str(settings.get("robot", robot)) if isinstance(settings, dict) else robot
    if is_path(robot) and not Path(robot).exists():
        raise KinfeasError(f"{policy}: its robot {robot} is not there; give its folder as 'robot'")
    return robot


def read_adapters(adapters: Adapters | None) -> tuple[PluginSpec, ...]:
    """Return adapters from a list, given by name, path or entries; an empty tuple for None."""
    if isinstance(adapters, Sequence) and not isinstance(adapters, str):
        kind = tuple[PluginSpec, ...]
        return cast("tuple[PluginSpec, ...]", checked(kind, adapters, "adapters"))
    return () if adapters is None else read_sim2real(str(adapters)).adapters


def plugin_settings(
    filters: str | Sequence[str] | None, adapters: Adapters | None = None, above: str = ""
) -> dict[str, object]:
    """Return settings of filters and adapters unless None; `above` is a prefix of their keys."""
    settings: dict[str, object] = {}
    if filters is not None:
        names = filter_names(filters) if isinstance(filters, str) else filters
        settings[f"{above}filters"] = names
    if adapters is not None:
        settings[f"{above}adapters"] = [spec.entry() for spec in read_adapters(adapters)]
    return settings


def filter_names(filters: str) -> tuple[str, ...]:
    """Return the names in a comma-separated list of filters; an empty tuple for `none`."""
    return () if filters in ("", "none") else tuple(map(str.strip, filters.split(",")))


def checked(kind: Any, value: object, name: str) -> Any:
    """Return an argument, plain or NumPy, as an instance of a type; or raise KinfeasError."""
    return validated(kind, value, "arguments", name)


def text_of(value: object, name: str) -> str:
    """Return an argument that is a name or a path; raise KinfeasError if it is not."""
    if not isinstance(value, str | Path):
        raise KinfeasError(f"{name!r} must be a name or a path, not {reprlib.repr(value)}")
    # Path drops "./", without which a folder in the working directory would be read as a name.
    alone = isinstance(value, Path) and len(value.parts) == 1 and value.is_dir()
    return f"./{value}" if alone else str(value)
