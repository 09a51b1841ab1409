"""What is known of a trained policy: the `policy.json` beside its weights."""

import json
import math
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from kinfeas import config
from kinfeas.config.quantities import Count, Episodes
from kinfeas.core.errors import KinfeasError
from kinfeas.core.policy import TermInfo
from kinfeas.io import strict_json
from kinfeas.io.folders import find_folder

_ABOUT = "policy.json"
_JUDGED = {"episodes", "success", "success_low", "success_high"}


@dataclass(frozen=True, kw_only=True)
class Trained:
    """What is known of a trained policy; whatever is not known is left out of its file.

    Attributes:
        format: Of the policy's files.
        robot: Name of the robot that it was trained for.
        layers: Count of layers of its network.
        observation: Observation terms in order.
        action: Action terms in order.
        kinematics: What `robots.fingerprint` says of that robot; None in files from before that
            was told.
        config: Settings of its training.
        steps: Environment steps that it learned from.
        evaluation: Figures by name, of the evaluation that picked it, which flatter it.
        fresh_evaluation: Figures by name, of as many other episodes; once its run has ended.
        seed: Of its training, of policies that come with the package.
        version: Of kinfeas, the same.
        command: That trains it, the same.
        benchmark: Figures by task, the same.
    """

    format: Literal[1] = 1
    robot: str
    layers: Count
    observation: tuple[TermInfo, ...]
    action: tuple[TermInfo, ...]
    kinematics: str | None = None
    config: dict[str, object] = field(default_factory=dict)
    steps: int | None = None
    evaluation: dict[str, Episodes | float] = field(default_factory=dict)
    fresh_evaluation: dict[str, Episodes | float] = field(default_factory=dict)
    seed: int | None = None
    version: str | None = None
    command: str | None = None
    benchmark: dict[str, object] = field(default_factory=dict)

    @property
    def trained_with(self) -> str:
        """The robot by name or by path, as the training's settings have it."""
        return str(self.config.get("robot", self.robot))

    @property
    def period(self) -> float | None:
        """Control period of its training in seconds; None where that is not known."""
        world = self.config.get("world")
        dt = world.get("dt") if isinstance(world, dict) else None
        return dt if isinstance(dt, float) and 0.0 < dt < math.inf else None


def policy_folder(folder: Path) -> Path:
    """Return where the policy of a training run (its best checkpoint) or of one checkpoint lies.

    Args:
        folder: `runs/NAME`, or a folder with `policy.safetensors` and `policy.json`.
    """
    best = find_folder(folder / "checkpoints" / "best")
    return best if best.is_dir() else find_folder(folder)


def read_trained(folder: Path) -> Trained:
    """Return what is known of the policy of a training run or of one checkpoint.

    Args:
        folder: As for `policy_folder`.

    Raises:
        KinfeasError: If there is no policy, or what is told of it is broken.
    """
    path = policy_folder(folder) / _ABOUT
    if not path.exists():
        raise KinfeasError(f"{folder}: not a training run or checkpoint: there is no {path}")
    told = strict_json.read(path)
    # Whatever else stands there is not ours to judge.
    known = {one.name: told[one.name] for one in fields(Trained) if one.name in told}
    return config.from_mapping(Trained, known, str(path))


def read_best(run: Path) -> Trained:
    """Return what is known of the best checkpoint of a training run, its evaluation included.

    Raises:
        KinfeasError: If there is none, or what is told of it is broken.
    """
    trained = read_trained(run)
    if trained.steps is None or not trained.evaluation.keys() >= _JUDGED:
        raise KinfeasError(f"{policy_folder(run)}: not the best checkpoint of a training run")
    return trained


def write_trained(trained: Trained, folder: Path) -> None:
    """Write what is known of a policy into an existing folder, for `read_trained` to read."""
    told = config.to_mapping(trained)
    known = {key: value for key, value in told.items() if value is not None and value != {}}
    (folder / _ABOUT).write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8")
