"""The training runs that a benchmark stands on: made where they are missing, else taken up."""

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.episodes import worker_pool
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import task_name
from kinfeas.training.config import TrainConfig
from kinfeas.training.run import finished

if TYPE_CHECKING:
    from kinfeas.training.train import Report

CORES = 2
"""That a training run keeps busy: one for the world, one for the learner."""

Plan = tuple[TrainConfig, Path]
"""The settings of a training run, and its folder."""


@dataclass(frozen=True)
class Run:
    """A training run.

    Attributes:
        folder: Where it lies.
        robot: Name of its robot.
        algorithm: `sac` or `td3`.
        seed: Its training seed.
        task: Name of what it was trained on.
    """

    folder: Path
    robot: str
    algorithm: str
    seed: int
    task: str


def read_run(folder: Path) -> Run:
    """Return what a run's `config.yaml` says of it.

    Raises:
        KinfeasError: If the folder is no run.
    """
    if not (folder / "config.yaml").is_file():
        raise KinfeasError(f"{folder}: not a training run: there is no config.yaml in it")
    settings = config.load(TrainConfig, folder / "config.yaml")
    robot = load_robot(settings.robot).name
    return Run(folder, robot, settings.learner.algorithm, settings.seed, task_name(settings.task))


def find_runs(folders: Sequence[Path]) -> list[Run]:
    """Return the runs that `folders` are or hold, by robot, algorithm and seed.

    Raises:
        KinfeasError: If a folder holds none, or two runs share robot, algorithm and seed.
    """
    found: dict[tuple[str, str, int], Run] = {}
    for folder in folders:
        below = sorted(path.parent for path in folder.glob("*/config.yaml"))
        for place in [folder] if (folder / "config.yaml").is_file() or not below else below:
            run = read_run(place)
            key = (run.robot, run.algorithm, run.seed)
            if (other := found.setdefault(key, run)).folder != run.folder:
                raise KinfeasError(
                    f"{other.folder} and {run.folder} both hold {run.robot} learned by "
                    f"{run.algorithm} with seed {run.seed}: leave one of them out"
                )
    return [found[key] for key in sorted(found)]


def is_missing(settings: TrainConfig, folder: Path) -> bool:
    """Return whether there is anything left to train.

    Raises:
        KinfeasError: If the folder holds a run of other settings, or a broken one.
    """
    if not (folder / "config.yaml").is_file():
        return True
    there = config.to_mapping(config.load(TrainConfig, folder / "config.yaml"))
    for key, value in config.to_mapping(settings).items():
        if there[key] != value:
            raise KinfeasError(
                f"{folder}: a run with another {key!r} than the study's: {there[key]} instead of "
                f"{value}; remove it, or choose another --out"
            )
    return finished(folder) is None


def finish(settings: TrainConfig, folder: Path, report: "Report | None" = None) -> None:
    """Train a run to its end, from its last checkpoint if there is one.

    Args:
        settings: What to do.
        folder: Of the run.
        report: Called every few seconds.
    """
    from kinfeas.training.train import resume, train

    if (folder / "config.yaml").is_file():
        resume(folder, report)
    else:
        train(settings, folder, report)


def finish_all(plans: Sequence[Plan], at_once: int, on_done: Callable[[], None]) -> None:
    """Train several runs to their ends, each in a process of its own.

    Args:
        plans: What to do and where.
        at_once: How many of them run at the same time.
        on_done: Called after each of them.

    Raises:
        KinfeasError: If one of them cannot be trained, or its process dies.
    """
    with worker_pool(at_once) as pool:
        for future in as_completed([pool.submit(finish, *plan) for plan in plans]):
            future.result()
            on_done()
