"""Files of a trained policy: `policy.json` and `policy.safetensors`."""

import json
import math
import shlex
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from safetensors import SafetensorError
from safetensors.numpy import load_file

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_undamaged, find_folder, read_json, reading
from kinfeas.core.policy import TermInfo
from kinfeas.core.quantities import Count, Episodes

WEIGHTS = "policy.safetensors"

_FILE = "policy.json"
_METRICS = {"episodes", "success", "success_low", "success_high"}


@dataclass(frozen=True, kw_only=True)
class Trained:
    """Metadata of a trained policy; unknown entries are absent from the file."""

    format: Literal[1] = 1  # version of the files
    robot: str  # name of the robot that it was trained for
    layers: Count  # number of layers of its network
    observation: tuple[TermInfo, ...]  # observation terms in order
    action: tuple[TermInfo, ...]  # action terms in order
    kinematics: str | None = None  # hash of the kinematics, from `robots.robot.fingerprint`
    weights: str | None = None  # hash of `policy.safetensors`, from `core.files.file_hash`
    config: dict[str, object] = field(default_factory=dict)  # configuration of the training
    steps: int | None = None  # environment steps of the training
    # metrics of the evaluation that selected it, which are biased
    evaluation: dict[str, Episodes | float] = field(default_factory=dict)
    # metrics of other episodes, which did not select it
    fresh_evaluation: dict[str, Episodes | float] = field(default_factory=dict)
    # of shipped policies: seed, version of kinfeas and command of the training
    seed: int | None = None
    version: str | None = None
    command: str | None = None

    @property
    def period(self) -> float | None:
        """Control period of the training in seconds; None if unknown."""
        world = self.config.get("world")
        dt = world.get("dt") if isinstance(world, dict) else None
        return dt if isinstance(dt, float) and 0.0 < dt < math.inf else None


def policy_folder(folder: Path) -> Path:
    """Return the best checkpoint of a training run `runs/NAME`, or `folder` if it is a checkpoint.

    Raises:
        KinfeasError: If it is neither.
    """
    best = find_folder(folder / "checkpoints" / "best")
    checkpoint = best if best.is_dir() else find_folder(folder)
    if not (checkpoint / _FILE).exists():
        plugin = (folder / "pyproject.toml").is_file()
        install = f"pip install --no-deps -e {shlex.quote(str(folder))}"
        hint = f"; to install a plugin: {install}" if plugin else ""
        raise KinfeasError(
            f"{folder}: not a training run or checkpoint: no {checkpoint / _FILE}{hint}"
        )
    return checkpoint


def read_policy(folder: Path) -> tuple[dict[str, Any], Trained]:
    """Return the tensors by name and the metadata of the policy in a training run or checkpoint."""
    path, trained = policy_folder(folder) / WEIGHTS, read_trained(folder)
    check_undamaged(path, trained.weights)
    try:
        with reading(path):
            tensors = load_file(path)
    # For truncated files, files of other formats, and data types that NumPy lacks.
    except (SafetensorError, KeyError, TypeError, AttributeError) as error:
        raise KinfeasError(f"{path}: broken: {error}") from error
    return tensors, trained


def read_trained(folder: Path) -> Trained:
    """Return the metadata of the policy in a training run or checkpoint."""
    path = policy_folder(folder) / _FILE
    data = read_json(path)
    entries = {entry.name: data[entry.name] for entry in fields(Trained) if entry.name in data}
    return config.from_mapping(Trained, entries, str(path))


def read_best(run: Path) -> Trained:
    """Return the metadata of the best checkpoint of a training run, with its evaluation."""
    trained = read_trained(run)
    if trained.steps is None or not trained.evaluation.keys() >= _METRICS:
        raise KinfeasError(f"{policy_folder(run)}: not the best checkpoint of a training run")
    return trained


def write_trained(trained: Trained, folder: Path) -> None:
    """Write metadata into an existing folder, for `read_trained`."""
    data = config.to_mapping(trained)
    entries = {key: value for key, value in data.items() if value is not None and value != {}}
    (folder / _FILE).write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")
