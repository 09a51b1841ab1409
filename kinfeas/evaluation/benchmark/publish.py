"""Policies made ready to come with the package: the best training seed of each robot."""

import json
import shlex
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kinfeas import __version__, config
from kinfeas.errors import KinfeasError
from kinfeas.evaluation.benchmark.runs import Run
from kinfeas.storage.folders import find_folder, write_folder
from kinfeas.storage.recipes import default_recipe
from kinfeas.training.config import TrainConfig

_WEIGHTS, _ABOUT = "policy.safetensors", "policy.json"


def publish(
    runs: Sequence[Run], figures: Mapping[Path, Mapping[str, Any]], folder: Path
) -> dict[str, Path]:
    """Copy each robot's best policy into `folder/ROBOT` and return these folders.

    The best one is that which did best in the evaluation that picked its checkpoint, and so not in
    the episodes that `figures` come from, which would flatter it.

    Args:
        runs: To choose from.
        figures: For each run's folder its figures by task, told in `policy.json`.
        folder: Where to write, such as `kinfeas/pretrained`.

    Raises:
        KinfeasError: If a run has no policy, or something cannot be written.
    """
    best: dict[str, tuple[float, Run, dict[str, Any]]] = {}
    for run in runs:
        about = _read_about(run)
        success = float(about["evaluation"]["success"])
        if run.robot not in best or success > best[run.robot][0]:
            best[run.robot] = success, run, about
    return {
        robot: _copy(run, about, dict(figures.get(run.folder, {})), folder / robot)
        for robot, (_, run, about) in best.items()
    }


def train_command(settings: TrainConfig) -> str:
    """Return the line that makes a run again: what its settings change of the default recipe."""
    name = Path(settings.robot).stem
    plain = config.to_mapping(config.load(TrainConfig, default_recipe("train", name)))
    changed = _changes(config.to_mapping(settings), {**plain, "robot": settings.robot})
    words = ["kinfeas", "train", "--robot", settings.robot, "--seed", str(settings.seed)]
    for key, value in changed.items():
        if key != "seed":
            words += ["--set", f"{key}={json.dumps(value)}"]
    return shlex.join(words)


def _changes(
    settings: Mapping[str, object], plain: Mapping[str, object], above: str = ""
) -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in settings.items():
        usual = plain.get(key)
        if isinstance(value, Mapping) and isinstance(usual, Mapping) and usual:
            found |= _changes(value, usual, f"{above}{key}.")
        elif value != usual:
            found[f"{above}{key}"] = value
    return found


def _place(run: Run) -> Path:
    return find_folder(run.folder / "checkpoints" / "best")


def _read_about(run: Run) -> dict[str, Any]:
    path = _place(run) / _ABOUT
    try:
        about: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        float(about["evaluation"]["success"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise KinfeasError(f"{path}: not the best checkpoint of a training run") from error
    return about


def _copy(run: Run, about: dict[str, Any], figures: dict[str, Any], target: Path) -> Path:
    settings = config.from_mapping(TrainConfig, about["config"], str(_place(run) / _ABOUT))
    told = {
        **about,
        "seed": run.seed,
        "version": __version__,
        "command": train_command(settings),
        "benchmark": figures,
    }

    def fill(folder: Path) -> None:
        shutil.copyfile(_place(run) / _WEIGHTS, folder / _WEIGHTS)
        (folder / _ABOUT).write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")

    write_folder(target, fill)
    return target
