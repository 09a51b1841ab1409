"""Training runs: their configuration, and their evaluation at the end."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

from kinfeas.api import Name
from kinfeas.api.load import Adapters, load_robot, read_adapters, robot_of, text_of
from kinfeas.config import Settings, merged, nested
from kinfeas.config.registry import from_anywhere
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.files import write_json
from kinfeas.training import run as training
from kinfeas.training.config import TrainConfig, duration, load_recipe
from kinfeas.training.run import Progress

_WORLD = "analytic"

OnTraining = Callable[[Progress], None]
"""Called with the progress of a run every few seconds."""


@dataclass(frozen=True)
class Run:
    """A training run that has ended."""

    folder: Path  # its folder, for `evaluate`, `export` and `load_policy`
    metrics: dict[str, Any]  # of its best checkpoint on fresh episodes, as in `evaluation.json`
    steps: int  # environment steps
    seconds: float  # wall-clock time of training


class Options(TypedDict, total=False):
    """Options of a training; where one is absent or None, the recipe's value applies."""

    task: Name | None
    seed: int | None
    minutes: float | None
    steps: int | None
    adapters: Adapters | None
    world: str
    init: Name | None
    processes: int | None
    config: Name | None
    settings: Settings | None


def train(
    robot: Name | None = None,
    *,
    out: Name | None = None,
    on_progress: OnTraining | None = None,
    **options: Unpack[Options],
) -> Run:
    """Train a base policy in the folder `out`, by default `runs/ROBOT-TASK-SEED`; return its run.

    Example: `kinfeas.train("pr2", minutes=3, settings={"learner.batch_size": 256})`

    Args:
        robot: Name or folder; by default the robot of `config` or `init`, else PR2.
        out: New folder.
        on_progress: Called with the `Progress` of the run every few seconds.
        task: Name or YAML file; `ggr` by default.
        seed: Random seed.
        minutes: Wall-clock time of training, 3 by default.
        steps: Environment steps, in place of or beside `minutes`.
        adapters: Name or YAML file of a list of adapters, or its entries.
        world: Backend: `analytic`, `pybullet`, `mujoco`, or a plugin.
        init: Policy to start from: a run folder, or `pretrained`.
        processes: Number of processes of a world with physics.
        config: Recipe: a YAML file, or a name such as `train_rooms`.
        settings: Values by key of the recipe, which override the other options.

    Raises:
        KinfeasError: If an option or a setting is invalid, or the folder holds a run.
    """
    config = configure(robot, **options)
    folder = default_folder(config) if out is None else Path(text_of(out, "out"))
    return begin(config, folder, on_progress)


def configure(robot: Name | None = None, **options: Unpack[Options]) -> TrainConfig:
    """Return the configuration of a run: the recipe, changed by options, then by settings."""
    for key, value in options.items():
        if key not in Options.__annotations__:
            hint = no_such(key, Options.__annotations__)
            setting = f'keys of the recipe are settings={{"{key}": {value!r}}}'
            raise KinfeasError(f"unknown option {key!r}{hint}; {setting}")
    init, config, world = options.get("init"), options.get("config"), options.get("world", _WORLD)
    changes: dict[str, object] = {"robot": None if robot is None else text_of(robot, "robot")}
    changes |= {key: options.get(key) for key in ("task", "seed", "init", "processes")}
    changes = {key: value for key, value in changes.items() if value is not None}
    if (adapters := options.get("adapters")) is not None:
        specs = [spec.entry() for spec in read_adapters(adapters)]
        changes |= {"world.adapters": specs, "evaluation_adapters": specs}
    changes |= duration(options.get("minutes"), options.get("steps"))
    recipe = load_recipe(
        None if config is None else str(config),
        nested(changes, options.get("settings")),
        backend=world,
        robot=robot_of(None if robot else init),
    )
    if recipe.world.backend != world:
        raise KinfeasError(f"world {world!r}: the recipe is for the world {recipe.world.backend!r}")
    robot_name, task_name = from_anywhere(recipe.robot), from_anywhere(recipe.task)
    recipe = replace(recipe, robot=robot_name, task=task_name)
    explicit = nested(options.get("settings"))
    if recipe.learner.net_arch != TrainConfig().learner.net_arch:  # set by the recipe
        explicit = merged({"learner": {"net_arch": recipe.learner.net_arch}}, explicit)
    return training.with_initial_policy(recipe, explicit)


def begin(config: TrainConfig, folder: Path, on_progress: OnTraining | None = None) -> Run:
    """Train in a new folder and return the run."""
    training.check_run_folder(folder)  # before torch, which is slow to import
    from kinfeas.training.train import train as run

    return _ended(folder, run(config, folder, on_progress))


def resume(
    folder: Name,
    *,
    minutes: float | None = None,
    steps: int | None = None,
    robot: Name | None = None,
    task: Name | None = None,
    on_progress: OnTraining | None = None,
) -> Run:
    """Resume a run from its last checkpoint and return it; larger limits extend a finished run.

    `robot` and `task` are new paths of the run's robot and task, if these have been moved.

    Raises:
        KinfeasError: If the folder is no run, a limit is invalid, or robot or task have changed.
    """
    path, changes = Path(text_of(folder, "folder")), duration(minutes, steps)
    moved = {"robot": robot, "task": task}
    changes |= {k: from_anywhere(text_of(v, k)) for k, v in moved.items() if v is not None}
    progress = training.finished(path, changes)
    if progress is None or robot or task:
        from kinfeas.training.train import resume as run

        progress = run(path, on_progress, changes)
    return _ended(path, progress)


def default_folder(config: TrainConfig) -> Path:
    """Return `runs/ROBOT-TASK-SEED`, with its engine appended for a run with physics."""
    robot, task = load_robot(config.robot).name, Path(config.task).stem
    backend = config.world.backend
    suffix = "" if backend == "analytic" else f"-{backend}"
    return Path("runs") / f"{robot}-{task}-{config.seed}{suffix}"


def _ended(folder: Path, progress: Progress) -> Run:
    metrics = training.read_evaluation(folder)
    write_json(metrics, folder / training.EVALUATION)
    return Run(folder, metrics, progress.steps, progress.seconds)
