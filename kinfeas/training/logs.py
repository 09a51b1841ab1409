"""Logs of a training run: `metrics.csv`, and trackers such as TensorBoard."""

import csv
import hashlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from kinfeas import __version__, config
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import reading, replacing, writing
from kinfeas.training.config import TrainConfig

LEARNER = ("train/actor_loss", "train/critic_loss", "train/ent_coef", "train/learning_rate")
"""Figures that are taken from SB3's own log."""

_EVALUATED = (
    "success", "tracked_5cm", "within_5cm", "ik_failures_per_episode", "mean_deviation_m",
    "joint_jumps_per_episode",
)  # fmt: skip

COLUMNS = (
    "steps", "seconds", "train/success", *LEARNER, *(f"evaluation/{name}" for name in _EVALUATED)
)  # fmt: skip
"""Columns of `metrics.csv`, in order."""


class TensorBoard:
    """Event files in `tensorboard` in the folder of the run."""

    def __init__(self, out: Path, settings: TrainConfig, steps: int) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self._folder = out / "tensorboard"
        with writing(self._folder):
            self._board = SummaryWriter(str(self._folder), purge_step=steps + 1, flush_secs=10)
            self._board.add_text("version", __version__, steps)
            recipe = strict_yaml.to_text(config.to_mapping(settings))
            self._board.add_text("recipe", recipe, steps)

    def log(self, figures: Mapping[str, float], steps: int) -> None:
        """Add figures by name."""
        with writing(self._folder):  # the writer's thread passes on its errors
            for key, value in figures.items():
                self._board.add_scalar(key, value, steps)

    def close(self) -> None:
        """End the run."""
        with writing(self._folder):
            self._board.close()


class Wandb:
    """A run of Weights & Biases; its environment variables apply, such as WANDB_MODE."""

    def __init__(self, out: Path, settings: TrainConfig, steps: int) -> None:
        import wandb

        self._run = wandb.init(
            project="kinfeas", name=str(out), id=_identity(out), resume="allow", dir=out,
            config={**config.to_mapping(settings), "version": __version__},
        )  # fmt: skip

    def log(self, figures: Mapping[str, float], steps: int) -> None:
        """Add figures by name."""
        self._run.log(dict(figures), step=steps)

    def close(self) -> None:
        """End the run."""
        self._run.finish()


TRACKERS: dict[str, type[TensorBoard | Wandb]] = {"tensorboard": TensorBoard, "wandb": Wandb}
"""Classes of trackers by name; they take the folder, settings and first step of a run."""


class Logs:
    """The logs of a run, open for writing; a context manager."""

    def __init__(self, out: Path, settings: TrainConfig, steps: int) -> None:
        """Open the logs of a run that resumes from `steps`; later rows are dropped."""
        self.path = out / "metrics.csv"
        with writing(self.path):
            rows = _rows_up_to(steps, self.path)
            # Replaced rather than overwritten, so that a kill here loses nothing.
            with (
                replacing(self.path) as fresh,
                fresh.open("w", newline="", encoding="utf-8") as file,
            ):
                table = _table(file)
                table.writeheader()
                table.writerows(rows)
            self._file = self.path.open("a", newline="", encoding="utf-8")
        self._table = _table(self._file)
        self.trackers = [TRACKERS[name](out, settings, steps) for name in settings.trackers]

    def __enter__(self) -> "Logs":
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # a full disk; `write` has raised for it
            self._file.close()
        for tracker in self.trackers:
            tracker.close()

    def write(self, row: dict[str, float]) -> None:
        """Write one row of figures."""
        with writing(self.path):
            self._table.writerow(row)
            self._file.flush()
        self.track({key: row[key] for key in row if key != "steps"}, int(row["steps"]))

    def track(self, figures: Mapping[str, float], steps: int) -> None:
        """Show figures that are not in `metrics.csv`."""
        for tracker in self.trackers:
            tracker.log(figures, steps)


def _identity(out: Path) -> str:
    """Return a name of the run in a folder, the same when it resumes."""
    return f"{out.name}-{hashlib.sha256(str(out.absolute()).encode()).hexdigest()[:10]}"


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
