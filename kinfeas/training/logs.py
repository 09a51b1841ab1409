"""Logs of a training run: `metrics.csv` and TensorBoard."""

import csv
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from kinfeas import __version__, config
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import reading, writing
from kinfeas.training.config import TrainConfig

LEARNER = ("train/actor_loss", "train/critic_loss", "train/ent_coef", "train/learning_rate")
"""Figures of SB3's own log that are kept."""

_EVALUATED = (
    "success",
    "within_5cm",
    "ik_failures_per_episode",
    "mean_deviation_m",
    "joint_jumps_per_episode",
)

COLUMNS = (
    "steps", "seconds", "train/success", *LEARNER, *(f"evaluation/{name}" for name in _EVALUATED)
)  # fmt: skip
"""Columns of `metrics.csv`, in order."""


class Logs:
    """The logs of a run, open for writing; a context manager."""

    def __init__(self, out: Path, settings: TrainConfig, steps: int) -> None:
        """Open them in the folder of a run that resumes from `steps`; later rows are dropped."""
        from torch.utils.tensorboard import SummaryWriter

        self.path, self._folder = out / "metrics.csv", out / "tensorboard"
        with writing(self.path):
            rows = _rows_up_to(steps, self.path)
            # Replaced rather than overwritten, so that a kill here loses nothing.
            fresh = out / ".metrics.csv.new"
            with fresh.open("w", newline="", encoding="utf-8") as file:
                table = _table(file)
                table.writeheader()
                table.writerows(rows)
            fresh.replace(self.path)
            self._file = self.path.open("a", newline="", encoding="utf-8")
        self._table = _table(self._file)
        recipe = strict_yaml.to_text(config.to_mapping(settings))
        with writing(self._folder):
            self._board = SummaryWriter(str(self._folder), purge_step=steps + 1, flush_secs=10)
            for name, text in {"version": __version__, "recipe": recipe}.items():
                self._board.add_text(name, text, steps)

    def __enter__(self) -> "Logs":
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # a full disk; `write` has raised for it
            self._file.close()
        with writing(self._folder):
            self._board.close()

    def write(self, row: dict[str, float]) -> None:
        """Write one row of metrics."""
        with writing(self.path):
            self._table.writerow(row)
            self._file.flush()
        self.track({key: row[key] for key in row if key != "steps"}, int(row["steps"]))

    def track(self, metrics: Mapping[str, float], steps: int) -> None:
        """Add metrics to TensorBoard alone."""
        with writing(self._folder):  # its thread passes on its errors
            for key, value in metrics.items():
                self._board.add_scalar(key, value, steps)


def _table(file: Any) -> "csv.DictWriter[str]":
    return csv.DictWriter(file, COLUMNS, extrasaction="ignore")


def _rows_up_to(steps: int, path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    with reading(path):
        file = path.open(newline="", encoding="utf-8")
    try:
        with file:
            return [row for row in csv.DictReader(file) if float(row["steps"]) <= steps]
    except (ValueError, TypeError, KeyError, csv.Error) as error:
        raise KinfeasError(f"{path}: not the metrics of a training run; remove it") from error
