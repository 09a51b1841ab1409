"""Policies made ready to come with the package: the best training seed of each robot."""

import json
import shlex
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from kinfeas import __version__, config
from kinfeas.benchmark.runs import Run
from kinfeas.config.recipes import load_section
from kinfeas.io.files import write_folder
from kinfeas.io.policy_metadata import Trained, policy_folder, read_best, write_trained
from kinfeas.policies.network import WEIGHTS
from kinfeas.training.config import TrainConfig


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
    judged = [(run, read_best(run.folder)) for run in runs]
    published = {}
    for robot in dict.fromkeys(run.robot for run in runs):
        own = [(run, trained) for run, trained in judged if run.robot == robot]
        run, trained = max(own, key=lambda one: one[1].evaluation["success"])
        published[robot] = _copy(run, trained, dict(figures.get(run.folder, {})), folder / robot)
    return published


def train_command(settings: TrainConfig) -> str:
    """Return the line that makes a run again: what its settings change of the default recipe."""
    name = Path(settings.robot).stem
    plain = config.to_mapping(load_section(TrainConfig, "train", name))
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


def _copy(run: Run, trained: Trained, figures: dict[str, Any], target: Path) -> Path:
    place = policy_folder(run.folder)
    settings = config.from_mapping(TrainConfig, trained.config, str(place))
    command = train_command(settings)
    told = replace(trained, seed=run.seed, version=__version__, command=command, benchmark=figures)

    def fill(folder: Path) -> None:
        shutil.copyfile(place / WEIGHTS, folder / WEIGHTS)
        write_trained(told, folder)

    write_folder(target, fill)
    return target
