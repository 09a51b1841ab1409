"""Trainings as jobs: they resume from their last checkpoint; the result is `evaluation.json`."""

from pathlib import Path
from typing import TYPE_CHECKING

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import Job, Result
from kinfeas.training.config import TrainConfig
from kinfeas.training.run import SETTINGS, read_evaluation

if TYPE_CHECKING:
    from kinfeas.training.train import Report


def training_job(settings: TrainConfig, folder: Path) -> Job:
    """Return the job of a training run; its folder may hold a part of this run, but no other."""
    if (folder / SETTINGS).is_file() and config.load(TrainConfig, folder / SETTINGS) != settings:
        raise KinfeasError(f"{folder}: a run of other settings; remove it, or use another --out")
    return Job(finish, (settings, folder), folder / "evaluation.json")


def finish(training: tuple[TrainConfig, Path], report: "Report | None" = None) -> Result:
    """Train a run of these settings in this folder to its end; return its fresh evaluation."""
    from kinfeas.training.train import resume, train

    settings, folder = training
    if (folder / SETTINGS).is_file():
        resume(folder, report)
    else:
        train(settings, folder, report)
    return read_evaluation(folder)
