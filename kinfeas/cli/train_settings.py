"""What `kinfeas train` is told, made into the settings of a run."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinfeas.cli import options
from kinfeas.cli.output import write_json
from kinfeas.cli.policy_robot import robot_of
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.training.config import TrainConfig


@dataclass(frozen=True)
class Wishes:
    """What the options say of a run; None leaves it to the recipe."""

    robot: str | None = None
    task: str | None = None
    seed: int | None = None
    minutes: float | None = None
    steps: int | None = None
    algorithm: str | None = None
    sim2real: str | None = None
    pybullet: bool | None = None
    init: str | None = None
    processes: int | None = None

    def overrides(self) -> list[str]:
        """Return them as `--set` would say them.

        Raises:
            KinfeasError: If a number or a name is none of those that are allowed.
        """
        from kinfeas.training.config import TrainConfig

        options.check_settings(
            TrainConfig,
            {
                "--seed": ("seed", self.seed),
                "--minutes": ("schedule.minutes", self.minutes),
                "--steps": ("schedule.steps", self.steps),
                "--algorithm": ("learner.algorithm", self.algorithm),
            },
        )
        said: dict[str, object] = {
            "robot": self.robot,
            "task": self.task,
            "seed": self.seed,
            "learner.algorithm": self.algorithm,
            "init": self.init,
            "processes": self.processes,
        }
        said = {key: value for key, value in said.items() if value is not None}
        if self.minutes is not None or self.steps is not None:
            said |= {"schedule.minutes": self.minutes, "schedule.steps": self.steps}
        if self.sim2real is not None:
            said["world.adapters"] = [vars(one) for one in options.read_adapters(self.sim2real)]
        return [f"{key}={json.dumps(value)}" for key, value in said.items()]


def read_settings(wishes: Wishes, recipe: str | None, overrides: list[str]) -> "TrainConfig":
    """Return the settings of a run: the recipe, then the options, then `--set`.

    Raises:
        KinfeasError: If recipe, robot, task, a key or a value is wrong.
    """
    from kinfeas.config.recipes import load_recipe, load_section
    from kinfeas.core.registry import from_anywhere
    from kinfeas.envs.world import World
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.run import with_initial_policy

    folder = "train"
    if wishes.pybullet:
        folder = "train_physics" if wishes.init is None else "finetune_physics"
    if recipe is None and wishes.robot is None and wishes.init is not None:
        wishes = replace(wishes, robot=robot_of(wishes.init))
    overrides = [*wishes.overrides(), *overrides]
    if recipe is None:
        name = options.read_robot(wishes.robot or TrainConfig.robot).name
        settings = load_section(TrainConfig, folder, name, overrides)
    else:
        settings = load_recipe(TrainConfig, recipe, folder, overrides)
    wanted = "pybullet" if wishes.pybullet else "analytic"
    if settings.world.backend != wanted:
        raise KinfeasError(f"{recipe}: 'world.backend' must be {wanted!r} for --world {wanted}")
    # What names something unknown is refused before there is a folder.
    robot, task = settings.robot, options.read_task(settings.task, settings.task_parameters)
    World(options.read_robot(robot), task, settings.world, settings.seed)
    named = replace(settings, robot=from_anywhere(robot), task=from_anywhere(settings.task))
    return with_initial_policy(named)


def default_folder(settings: "TrainConfig") -> Path:
    """Return `runs/ROBOT-TASK-SEED`, with `-pybullet` behind it for a run with physics."""
    robot, task = Path(settings.robot).stem, Path(settings.task).stem
    backend = settings.world.backend
    suffix = "" if backend == "analytic" else f"-{backend}"
    return Path("runs") / f"{robot}-{task}-{settings.seed}{suffix}"


def best_figures(folder: Path) -> dict[str, Any]:
    """Return what a finished run's best checkpoint did on fresh episodes.

    Raises:
        KinfeasError: If the run has none, or it cannot be read.
    """
    from kinfeas.config import from_mapping
    from kinfeas.io.policy_metadata import read_best
    from kinfeas.training.config import TrainConfig

    best = read_best(folder)
    settings = from_mapping(TrainConfig, best.config, str(folder))
    return {
        "robot": best.robot,
        "trained_with": settings.robot,
        "task": settings.task,
        "world": settings.world.backend,
        "policy": str(folder),
        "steps": best.steps,
        **best.fresh_evaluation,
    }


def write_evaluation(folder: Path) -> dict[str, Any]:
    """Write what `best_figures` returns into the folder of a run that has ended; return it."""
    figures = best_figures(folder)
    write_json(figures, folder / "evaluation.json")
    return figures
