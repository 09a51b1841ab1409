"""What the commands do, as functions: `kinfeas.train`, `evaluate`, `export` and `load_policy`.

`import kinfeas` offers them and imports this module with the first call. Whatever is slow to import
is imported within the functions.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from kinfeas.cli import options
from kinfeas.cli.export import export_policy, facts
from kinfeas.cli.output import check_file_path, check_suffix
from kinfeas.cli.policy_robot import check_policy, robot_of
from kinfeas.cli.train_settings import Wishes, default_folder, read_settings, write_evaluation
from kinfeas.config import Interval, convert
from kinfeas.config.quantities import LAST_SEED, MOST_EPISODES, MOST_PROCESSES
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.core.policy import Policy
    from kinfeas.evaluation.evaluate import Summary
    from kinfeas.training.run import Progress

__all__ = ["Run", "evaluate", "export", "load_policy", "train"]

WorldName = Literal["analytic", "pybullet"]


@dataclass(frozen=True)
class Run:
    """A training run that has ended.

    Attributes:
        folder: Its folder, which `evaluate`, `export` and `load_policy` take.
        figures: The evaluation of its best checkpoint, as in its `evaluation.json`.
        steps: Environment steps.
        seconds: Wall-clock time.
    """

    folder: Path
    figures: dict[str, Any]
    steps: int
    seconds: float


def train(  # noqa: PLR0913 - the options of the command
    robot: str | Path | None = None,
    *,
    task: str | Path | None = None,
    seed: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    algorithm: Literal["sac", "td3"] | None = None,
    adapters: str | Path | None = None,
    world: WorldName = "analytic",
    init: str | Path | None = None,
    processes: int | None = None,
    out: str | Path | None = None,
    config: str | Path | None = None,
    settings: Mapping[str, object] | None = None,
    on_progress: "Callable[[Progress], None] | None" = None,
) -> Run:
    """Train a base policy and return its run, as `kinfeas train` does.

    Example: `run = kinfeas.train("pr2", minutes=3, settings={"learner.batch_size": 256})`

    Args:
        robot: Name or YAML file; like all arguments that are None, the recipe's.
        task: Name or YAML file.
        seed: Of all randomness.
        minutes: Wall-clock minutes in all.
        steps: Environment steps in all.
        algorithm: The learning algorithm.
        adapters: Adapters by name or YAML file.
        world: With physics, or without.
        init: Policy to start from: the folder of a run, or `pretrained`.
        processes: Worlds side by side with physics.
        out: New folder of the run; by default `runs/ROBOT-TASK-SEED`.
        config: Recipe by name, or a YAML file.
        settings: Keys of the recipe and their values, as `--set` has them.
        on_progress: Called now and then with how far it is.

    Raises:
        KinfeasError: If an argument or a setting is wrong, or the folder holds a run already.
    """
    from kinfeas.training.run import check_new
    from kinfeas.training.train import train as run

    if processes is not None and _world(world) == "analytic":
        raise KinfeasError("processes needs world='pybullet'")
    wishes = Wishes(
        _name(robot), _name(task), seed, minutes, steps, algorithm, _name(adapters),
        True if _world(world) == "pybullet" else None, _name(init), processes,
    )  # fmt: skip
    chosen = read_settings(wishes, _name(config), _assignments(settings))
    folder = default_folder(chosen) if out is None else Path(out)
    check_new(folder)
    progress = run(chosen, folder, on_progress)
    return Run(folder, write_evaluation(folder), progress.steps, progress.seconds)


def evaluate(  # noqa: PLR0913 - the options of the command
    policy: str | Path,
    *,
    robot: str | Path | None = None,
    task: str | Path = "ggr",
    world: WorldName = "analytic",
    episodes: int | None = None,
    seed: int = 1,
    filters: Sequence[str] | None = None,
    adapters: str | Path | None = None,
    processes: int = 1,
    settings: Mapping[str, object] | None = None,
    on_done: Callable[[int], None] | None = None,
) -> "Summary":
    """Return the figures of a policy, those of `kinfeas evaluate --json`.

    Example: `kinfeas.evaluate("pretrained", robot="pr2", episodes=100)["success"]`

    Args:
        policy: Folder of a run, ONNX file, baseline or `pretrained`.
        robot: Name or YAML file; by default the one that the policy was trained for.
        task: Name or YAML file.
        world: With physics, or without.
        episodes: How many; by default 500, with physics 50.
        seed: Of all episodes.
        filters: Names of command filters; by default those of the robot in this world.
        adapters: Adapters by name or YAML file.
        processes: How many processes share the episodes.
        settings: Keys such as `world.dt` and their values, as `--set` has them.
        on_done: Called with the number of episodes that have just ended.

    Raises:
        KinfeasError: If an argument or a setting is wrong.
    """
    from kinfeas.evaluation import evaluate as evaluation

    name = str(policy)
    check_policy(name)
    specs = () if adapters is None else options.read_adapters(str(adapters))
    count = evaluation.default_episodes(_world(world)) if episodes is None else episodes
    for key, value, low, high in (
        ("episodes", count, 1, MOST_EPISODES),
        ("seed", seed, 0, LAST_SEED),
        ("processes", processes, 1, MOST_PROCESSES),
    ):
        convert(Annotated[int, Interval(low=low, high=high)], value, "the arguments", key)
    chosen, driver = evaluation.prepare(
        name,
        _name(robot) or robot_of(name),
        str(task),
        world,
        episodes=count,
        seed=seed,
        overrides=options.with_filters(filters, _assignments(settings)),
    )
    evaluation.check_adapters(specs, chosen.robot)
    ceiling = evaluation.reachability_of(chosen)
    return evaluation.evaluate(chosen.within(specs), driver, name, ceiling, processes, on_done)


def export(
    policy: str | Path, out: str | Path, *, robot: str | Path | None = None
) -> dict[str, object]:
    """Write a policy as one ONNX file and return what it tells of itself, as `kinfeas export` does.

    Example: `kinfeas.export("runs/pr2-ggr-0", "pr2.onnx")`

    Args:
        policy: Folder of a run or of a checkpoint, or `pretrained`.
        out: ONNX file to write.
        robot: Name or YAML file; by default the one that the policy was trained for.

    Raises:
        KinfeasError: If the policy is none or for another robot, or the file cannot be written.
    """
    path = Path(out)
    check_file_path(path)
    check_suffix("out", path, ".onnx")
    found, off = export_policy(str(policy), _name(robot), path)
    return {**facts(found, path), "parity": off}


def load_policy(policy: str | Path, *, robot: str | Path | None = None) -> "Policy":
    """Return a policy, whose `act` returns base commands, shape (n, action size), in [-1, 1].

    Example: `act = kinfeas.load_policy("pretrained", robot="tiago").act`

    Args:
        policy: Folder of a run, ONNX file, baseline or `pretrained`.
        robot: Name or YAML file; by default the one that the policy was trained for.

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    from kinfeas.policies.loading import load_policy as load

    name = str(policy)
    check_policy(name)
    return load(name, options.read_robot(_name(robot) or robot_of(name)))


def _name(value: str | Path | None) -> str | None:
    return None if value is None else str(value)


def _world(name: str) -> str:
    if name not in ("analytic", "pybullet"):
        raise KinfeasError(f"world must be 'analytic' or 'pybullet', not {name!r}")
    return name


def _assignments(settings: Mapping[str, object] | None) -> list[str]:
    """Return settings as `--set` would say them."""
    return [f"{key}={json.dumps(value, default=str)}" for key, value in (settings or {}).items()]
