"""Robots, tasks and policies by name or path."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinfeas.api import DEFAULT_ROBOT, Name
from kinfeas.config import PluginSpec, convert
from kinfeas.control.adapters import read_sim2real
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import Policy
from kinfeas.io.files import is_path
from kinfeas.io.policy_metadata import Trained, read_trained
from kinfeas.policies import loading
from kinfeas.policies.network import read_network
from kinfeas.policies.onnx_policy import OnnxPolicy, read_policy_file
from kinfeas.robots import loading as robots
from kinfeas.robots.robot import Robot


@dataclass(frozen=True)
class LoadedPolicy:
    """A policy and the robot that it commands.

    Attributes:
        name: Name of the policy.
        policy: The policy.
        robot_name: Name of the robot, or path of its YAML file.
        robot: The robot.
    """

    name: str
    policy: Policy
    robot_name: str
    robot: Robot


def load_robot(robot: Name) -> Robot:
    """Return a robot by its name or YAML file.

    Raises:
        KinfeasError: If there is no such robot, or a file is invalid.
    """
    return robots.load_robot(str(robot))


def load_policy(policy: Name, *, robot: Name | None = None) -> Policy:
    """Return a policy, whose `act` returns base commands of shape (n, action size), in [-1, 1].

    Example: `kinfeas.load_policy("pretrained", robot="tiago").act`

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    return load(policy, robot).policy


def load(policy: Name, robot: Name | None = None) -> LoadedPolicy:
    """Return a policy with a robot: by default the one that it was trained for, else PR2."""
    name = str(policy)
    trained = None if robot else _read_trained(name)
    robot_name = str(robot or _robot_of(name, trained))
    known = robots.load_robot(robot_name)
    if isinstance(trained, OnnxPolicy):
        trained.check_robot(known, name)
        loaded: Policy = trained
    elif trained is not None:
        loaded = read_network(Path(name), known, trained)
    else:
        loaded = loading.load_policy(name, known)
    return LoadedPolicy(name, loaded, robot_name, known)


def robot_of(policy: Name | None) -> str:
    """Return the robot that a policy was trained for, by name or path; PR2 for other policies."""
    name = str(policy or "")
    return _robot_of(name, _read_trained(name))


def read_adapters(name: Name | None) -> tuple[PluginSpec, ...]:
    """Return a list of adapters by name or path; none for None."""
    return () if name is None else read_sim2real(str(name)).adapters


def filter_specs(filters: str | Sequence[str] | None, key: str) -> dict[str, object]:
    """Return filters as a setting; they are names, also as one text with commas, or `none`."""
    return {} if filters is None else {key: filter_names(filters)}


def filter_names(filters: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of filters, which may be one text with commas or `none`."""
    names = filters.split(",") if isinstance(filters, str) else filters
    return tuple(name.strip() for name in names if name.strip() not in ("", "none"))


def checked(kind: object, value: object, name: str) -> int:
    """Return an argument that is an integer of a kind; raise KinfeasError if it is not."""
    number: int = convert(kind, value, "arguments", name)
    return number


def _read_trained(name: str) -> Trained | OnnxPolicy | None:
    """Return metadata of a trained policy's folder, or an exported policy."""
    path = Path(name)
    if not name or name in registry.names(loading.GROUP) or not path.exists():
        return None
    return read_trained(path) if path.is_dir() else read_policy_file(path, None)


def _robot_of(name: str, trained: Trained | OnnxPolicy | None) -> str:
    if trained is None:
        return DEFAULT_ROBOT
    metadata = trained.metadata if isinstance(trained, OnnxPolicy) else trained
    robot = metadata.trained_with
    if is_path(robot) and not Path(robot).is_file():
        raise KinfeasError(f"{name}: its robot {robot} does not exist; use --robot")
    return robot
