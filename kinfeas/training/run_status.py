"""Where a training run stands: its settings and its last checkpoint, read without torch."""

from collections.abc import Sequence
from pathlib import Path

from kinfeas import config as configuration
from kinfeas.core.errors import KinfeasError
from kinfeas.io.folders import find_folder
from kinfeas.io.policy_metadata import read_trained
from kinfeas.training.config import ScheduleConfig, TrainConfig
from kinfeas.training.progress import Progress, read_progress
from kinfeas.training.run_folder import SETTINGS, check_begun
from kinfeas.training.state import loading, read_state


def read_settings(out: Path, overrides: Sequence[str] = ()) -> TrainConfig:
    """Return the settings of the run in a folder, with assignments `a.b=c` that win over them.

    Raises:
        KinfeasError: If there is no run, or its settings are broken.
    """
    check_begun(out)
    return configuration.load(TrainConfig, out / SETTINGS, overrides)


def finished(out: Path, overrides: Sequence[str] = ()) -> Progress | None:
    """Return how far a run has come that has nothing left to do, None for any other.

    Args:
        out: Folder of the run.
        overrides: Assignments `a.b=c` that win over its settings.

    Raises:
        KinfeasError: If the folder is no run, or its settings or its checkpoint are broken.
    """
    config, last = read_settings(out, overrides), find_folder(out / "checkpoints" / "last")
    if not last.is_dir():
        return None
    progress = read_standing(config, last)
    ended = progress.share >= 1.0 and progress.evaluations >= evaluations_due(config, progress)
    return progress if ended and read_trained(out).fresh_evaluation else None


def read_standing(config: TrainConfig, last: Path) -> Progress:
    """Return how far a run of these settings has come by its last checkpoint.

    Raises:
        KinfeasError: If the checkpoint is broken, or of a run with other settings.
    """
    state = read_state(last)
    with loading(last):
        _check_same(config, state["config"], last)
        progress = read_progress(state["progress"])
    # The schedule may have been made longer.
    progress.share = share_done(config.schedule, progress)
    progress.evaluations = min(progress.evaluations, evaluations_due(config, progress))
    return progress


def share_done(schedule: ScheduleConfig, progress: Progress) -> float:
    """Return which share of its steps, or of its time if that is more, a run has done, 0-1."""
    shares = [0.0]
    if schedule.steps is not None:
        shares.append(progress.steps / schedule.steps)
    if schedule.minutes is not None:
        shares.append(progress.seconds / (60.0 * schedule.minutes))
    return min(1.0, max(shares))


def evaluations_due(config: TrainConfig, progress: Progress) -> int:
    """Return how many evaluations there should have been by now."""
    # What the run goes on from is judged, too: it may stay the best.
    first = config.init is not None
    return first + int(progress.share * config.schedule.evaluations)


def identity(config: TrainConfig) -> dict[str, object]:
    """Return what must be the same for a run to go on: everything but how long it lasts."""
    mapping = configuration.to_mapping(config)
    del mapping["schedule"]
    return mapping


def _check_same(config: TrainConfig, told: object, last: Path) -> None:
    # What was no key yet when the checkpoint was written had its default.
    saved = identity(configuration.from_mapping(TrainConfig, told, str(last)))
    for key, value in identity(config).items():
        if saved[key] != value:
            raise KinfeasError(
                f"{last}: a checkpoint of another run: its {key} is {saved[key]}, "
                f"but {last.parents[1] / SETTINGS} says {value}"
            )
