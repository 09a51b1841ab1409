"""Training runs: their configuration, and their evaluation at the end."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from kinfeas.api import Name
from kinfeas.api.load import load_robot, read_adapters, robot_of
from kinfeas.config import Settings, to_mapping
from kinfeas.config.recipes import recipes
from kinfeas.control.adapters import FOLDER, read_sim2real
from kinfeas.core.errors import KinfeasError
from kinfeas.core.registry import from_anywhere
from kinfeas.evaluation import evaluate as evaluation
from kinfeas.io.files import write_json
from kinfeas.training import run as training
from kinfeas.training.config import TrainConfig, load_recipe
from kinfeas.training.run import Progress

OnTraining = Callable[[Progress], None]
"""Called with the progress of a run now and then."""


@dataclass(frozen=True)
class Run:
    """A training run that has ended.

    Attributes:
        folder: Its folder, for `evaluate`, `export` and `load_policy`.
        metrics: Metrics of its best checkpoint on fresh episodes, as in `evaluation.json`.
        steps: Environment steps.
        seconds: Wall-clock time of training.
        evaluation_seconds: Wall-clock time of the evaluations of this process.
    """

    folder: Path
    metrics: dict[str, Any]
    steps: int
    seconds: float
    evaluation_seconds: float


def train(  # noqa: PLR0913 - options of the command
    robot: Name | None = None,
    *,
    task: Name | None = None,
    seed: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    algorithm: Literal["sac", "td3"] | None = None,
    adapters: Name | None = None,
    world: str = "analytic",
    init: Name | None = None,
    processes: int | None = None,
    out: Name | None = None,
    config: Name | None = None,
    settings: Settings | None = None,
    on_progress: OnTraining | None = None,
) -> Run:
    """Train a base policy and return its run.

    Example: `kinfeas.train("pr2", minutes=3, settings={"learner.batch_size": 256})`

    Arguments that are None have the value of the recipe.

    Args:
        robot: Name or YAML file; by default that of the recipe or of `init`, else PR2.
        task: Name or YAML file.
        seed: Seed of all randomness.
        minutes: Wall-clock time.
        steps: Environment steps, in place of `minutes` or beside them.
        algorithm: Algorithm.
        adapters: Adapters of training and evaluations, by name or YAML file.
        world: Backend.
        init: Policy to start from.
        processes: Processes of a world with physics.
        out: New folder of the run; by default `runs/ROBOT-TASK-SEED`.
        config: Recipe by name or YAML file; by default that of the robot.
        settings: Values by key of the recipe, which win over the other arguments.
        on_progress: Called with the progress now and then.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the folder holds a run.
    """
    chosen = configure(
        robot, task=task, seed=seed, minutes=minutes, steps=steps, algorithm=algorithm,
        adapters=adapters, world=world, init=init, processes=processes, config=config,
        settings=settings,
    )  # fmt: skip
    return begin(chosen, default_folder(chosen) if out is None else Path(out), on_progress)


def configure(  # noqa: PLR0913 - options of the command
    robot: Name | None = None,
    *,
    task: Name | None = None,
    seed: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    algorithm: str | None = None,
    adapters: Name | None = None,
    world: str = "analytic",
    init: Name | None = None,
    processes: int | None = None,
    config: Name | None = None,
    settings: Settings | None = None,
) -> TrainConfig:
    """Return the configuration of a run: the recipe, then the arguments, then `settings`."""
    options = {"robot": robot, "task": task, "seed": seed, "init": init, "processes": processes}
    options |= {"learner.algorithm": algorithm}
    changes = {key: value for key, value in options.items() if value is not None}
    if adapters is not None:
        specs = to_mapping(read_adapters(adapters))
        changes |= {"world.adapters": specs, "evaluation_adapters": specs}
    changes |= duration(minutes, steps)
    recipe = load_recipe(
        None if config is None else str(config),
        {**changes, **(settings or {})},
        backend=world,
        robot=robot_of(None if robot else init),
    )
    if recipe.world.backend != world:
        raise KinfeasError(f"world {world!r}: the recipe is for the world {recipe.world.backend!r}")
    paths = {"robot": from_anywhere(recipe.robot), "task": from_anywhere(recipe.task)}
    return training.with_initial_policy(replace(recipe, **paths))


def begin(config: TrainConfig, folder: Path, on_progress: OnTraining | None = None) -> Run:
    """Train in a new folder and return the run; `train` does it by options."""
    training.check_new(folder)
    from kinfeas.training.train import train as run

    return _ended(folder, run(config, folder, on_progress))


def resume(
    folder: Name,
    *,
    minutes: float | None = None,
    steps: int | None = None,
    on_progress: OnTraining | None = None,
) -> Run:
    """Resume a run from its last checkpoint and return it; larger limits extend a finished run.

    Raises:
        KinfeasError: If the folder is no run, or a limit is invalid.
    """
    path, longer = Path(folder), duration(minutes, steps)
    progress = training.finished(path, longer)
    if progress is None:
        from kinfeas.training.train import resume as run

        progress = run(path, on_progress, longer)
    return _ended(path, progress)


def duration(minutes: float | None, steps: int | None) -> dict[str, object]:
    """Return settings of the duration; one limit lifts the other one of the recipe."""
    if minutes is None and steps is None:
        return {}
    return {"schedule.minutes": minutes, "schedule.steps": steps}


def default_folder(config: TrainConfig) -> Path:
    """Return `runs/ROBOT-TASK-SEED`, with its engine appended for a run with physics."""
    robot, task = Path(config.robot).stem, Path(config.task).stem
    backend = config.world.backend
    suffix = "" if backend == "analytic" else f"-{backend}"
    return Path("runs") / f"{robot}-{task}-{config.seed}{suffix}"


def evaluation_options(folder: Path) -> tuple[str | None, dict[str, object]]:
    """Return the list of adapters and the settings with which `evaluate` repeats a run's figures.

    They are those that are not the robot's own; the list is a shipped one, if it has the adapters.
    """
    config = training.read_settings(folder)
    settings: dict[str, object] = {f"task.{k}": v for k, v in config.task_parameters.items()}
    usual = evaluation.read_settings(load_robot(config.robot).name, config.world.backend).world
    adapters, filters = config.evaluation_adapters, config.world.filters
    names = [name for name in recipes(FOLDER) if read_sim2real(name).adapters == adapters]
    shipped = names[0].partition("/")[2] if adapters and names else None
    if filters != usual.filters:
        settings["world.filters"] = to_mapping(filters)
    if shipped is None and adapters != usual.adapters:
        settings["world.adapters"] = to_mapping(adapters)
    return shipped, settings


def _ended(folder: Path, progress: Progress) -> Run:
    metrics = training.read_evaluation(folder)
    write_json(metrics, folder / "evaluation.json")
    seconds = progress.parts.get("evaluation", 0.0)
    return Run(folder, metrics, progress.steps, progress.seconds, seconds)
