"""Training runs of a benchmark, and the best of them made ready to be shipped."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinfeas import __version__, config
from kinfeas.benchmark.config import BenchmarkConfig, Training
from kinfeas.core.errors import KinfeasError
from kinfeas.io.policy_metadata import Trained, policy_folder, read_best
from kinfeas.jobs.job import Job, training_job
from kinfeas.policies.loading import PRETRAINED, trained_policies
from kinfeas.policies.network import copy_network
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import task_name
from kinfeas.training.config import TrainConfig, duration, load_recipe
from kinfeas.training.run import read_settings, with_initial_policy


@dataclass(frozen=True)
class TrainedRun:
    """A training run: its folder and settings."""

    folder: Path
    robot: str
    seed: int
    task: str
    label: str = ""  # of its rows; runs without one are averaged over their seeds


def read_run(folder: Path) -> TrainedRun:
    """Return the training run of a folder."""
    settings = read_settings(folder)
    robot = load_robot(settings.robot).name
    return TrainedRun(folder, robot, settings.seed, task_name(settings.task))


def find_runs(folders: Sequence[Path]) -> list[TrainedRun]:
    """Return the runs in `folders` and one level below, by robot and seed.

    Those of a robot that has two of one seed are labelled with the names of their folders.
    """
    runs: dict[Path, TrainedRun] = {}
    for folder in folders:
        below = sorted(path.parent for path in folder.glob("*/config.yaml"))
        for path in [folder] if (folder / "config.yaml").is_file() or not below else below:
            runs[path] = read_run(path)
    seeds = Counter((run.robot, run.seed) for run in runs.values())
    several = {robot for (robot, _), count in seeds.items() if count > 1}
    found: dict[tuple[str, int, str], TrainedRun] = {}
    for path, run in runs.items():
        label = path.name if run.robot in several else ""
        same = found.setdefault((run.robot, run.seed, label), replace(run, label=label))
        if same.folder != path:
            raise KinfeasError(f"{same.folder} and {path}: both {run.robot} with seed {run.seed}")
    return [found[key] for key in sorted(found)]


def takes_pretrained(benchmark: BenchmarkConfig, robot: str) -> bool:
    """Return whether a benchmark takes the shipped policy of a robot."""
    if benchmark.policies == "train":
        return False
    return benchmark.policies == PRETRAINED or PRETRAINED in trained_policies(load_robot(robot))


def plan_runs(benchmark: BenchmarkConfig, out: Path) -> list[Job]:
    """Return the training runs of a benchmark."""
    if benchmark.policies == PRETRAINED:
        return []
    robots = [robot for robot in benchmark.robots if not takes_pretrained(benchmark, robot)]
    for robot in robots:
        if robot not in {training.robot for training in benchmark.trainings}:
            raise KinfeasError(f"'trainings' has no entry for {robot}")
    plans = {}
    for training in benchmark.trainings:
        for seed in benchmark.seeds if training.robot in robots else ():
            settings = _settings(training, seed)
            name = f"{load_robot(settings.robot).name}-{seed}"
            if name in plans:
                raise KinfeasError(f"'trainings' has two runs {name}")
            plans[name] = training_job(settings, out / "runs" / name)
    return list(plans.values())


def publish(runs: Sequence[TrainedRun], folder: Path) -> list[Path]:
    """Copy the best policy of each robot into `folder/ROBOT` and return these folders.

    The best one has the highest success in the evaluation that selected its checkpoint.
    """
    best: dict[str, tuple[TrainedRun, Trained]] = {}
    for run in runs:
        trained = read_best(run.folder)
        success = trained.evaluation["success"]
        if run.robot not in best or success > best[run.robot][1].evaluation["success"]:
            best[run.robot] = run, trained
    for robot, (run, trained) in best.items():
        about = replace(trained, seed=run.seed, version=__version__)
        copy_network(policy_folder(run.folder), about, folder / robot)
    return [folder / robot for robot in best]


def _settings(training: Training, seed: int) -> TrainConfig:
    values = {"robot": training.robot, "seed": seed}
    limits = duration(training.minutes, training.steps)
    settings = config.nested(values, limits, training.settings)
    return with_initial_policy(load_recipe(training.recipe, settings), training.settings)
