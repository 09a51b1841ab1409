"""The commands as functions: `kinfeas.train`, `evaluate`, `export` and `load_policy`.

`import kinfeas` imports this module with the first use of one of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinfeas.cli import options
from kinfeas.cli.export import export_policy, facts
from kinfeas.cli.output import check_file_path, check_suffix
from kinfeas.cli.train import default_folder, read_settings, write_evaluation
from kinfeas.config import convert
from kinfeas.config.quantities import Episodes, Processes, Seed

if TYPE_CHECKING:
    from kinfeas.core.policy import Policy
    from kinfeas.evaluation.evaluate import Summary
    from kinfeas.training.run import Progress


@dataclass(frozen=True)
class Run:
    """A training run that has ended.

    Attributes:
        folder: Its folder, for `evaluate`, `export` and `load_policy`.
        metrics: Metrics of its best checkpoint on fresh episodes, as in `evaluation.json`.
        steps: Environment steps.
        seconds: Wall-clock time.
    """

    folder: Path
    metrics: dict[str, Any]
    steps: int
    seconds: float


def train(  # noqa: PLR0913 - options of the command
    robot: str | Path | None = None,
    *,
    task: str | Path | None = None,
    seed: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    adapters: str | Path | None = None,
    world: str = "analytic",
    init: str | Path | None = None,
    processes: int | None = None,
    out: str | Path | None = None,
    config: str | Path | None = None,
    settings: Mapping[str, object] | None = None,
    on_progress: "Callable[[Progress], None] | None" = None,
) -> Run:
    """Train a base policy and return its run; arguments are those of `kinfeas train`.

    Example: `kinfeas.train("pr2", minutes=3, settings={"learner.batch_size": 256})`

    Arguments that are None have the value of the recipe. `settings` are values by key of the
    recipe, as for `--set`. `on_progress` is called with the progress now and then.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the folder holds a run.
    """
    from kinfeas.training.train import train as run

    chosen = read_settings(
        _name(robot), _name(task), seed=seed, minutes=minutes, steps=steps,
        adapters=_name(adapters), world=world, init=_name(init), processes=processes,
        config=_name(config), overrides=options.assignments(settings or {}),
    )  # fmt: skip
    folder = default_folder(chosen) if out is None else Path(out)
    progress = run(chosen, folder, on_progress)
    return Run(folder, write_evaluation(folder), progress.steps, progress.seconds)


def evaluate(  # noqa: PLR0913 - options of the command
    policy: str | Path,
    *,
    robot: str | Path | None = None,
    task: str | Path = "ggr",
    world: str = "analytic",
    episodes: int | None = None,
    seed: int = 1,
    filters: str | Sequence[str] | None = None,
    adapters: str | Path | None = None,
    processes: int = 1,
    settings: Mapping[str, object] | None = None,
    on_done: Callable[[int], None] | None = None,
) -> "Summary":
    """Return the metrics of a policy; arguments are those of `kinfeas evaluate`.

    Example: `kinfeas.evaluate("pretrained", robot="pr2", episodes=100)["success"]`

    `policy` is a run folder, an ONNX file, `pretrained`, `module:Class`, or a plugin such as a
    baseline. `settings` are values by key such as `world.dt`, as for `--set`. `on_done` is called
    with the number of episodes that have just ended.

    Raises:
        KinfeasError: If an argument or a setting is invalid.
    """
    from kinfeas.evaluation import evaluate as evaluation

    name = str(policy)
    given = options.adapters_of_world(_name(adapters)) | dict(settings or {})
    overrides = options.with_filters(filters, options.assignments(given))
    chosen, driver = evaluation.prepare(
        name,
        _name(robot) or options.robot_of(name),
        str(task),
        world,
        episodes=None if episodes is None else convert(Episodes, episodes, "evaluate", "episodes"),
        seed=convert(Seed, seed, "evaluate", "seed"),
        overrides=overrides,
    )
    processes = convert(Processes, processes, "evaluate", "processes")
    ceiling = evaluation.reachability_of(chosen)
    return evaluation.evaluate(chosen, driver, name, ceiling, processes, on_done)


def export(
    policy: str | Path, out: str | Path, *, robot: str | Path | None = None
) -> dict[str, object]:
    """Write a policy as an ONNX file and return its metadata, as `kinfeas export` does.

    Example: `kinfeas.export("runs/pr2", "pr2.onnx")`

    Raises:
        KinfeasError: If the policy is not a trained one or for another robot, or the file cannot
            be written.
    """
    path = Path(out)
    check_file_path(path)
    check_suffix(path, ".onnx")
    found, deviation = export_policy(str(policy), _name(robot), path)
    return {**facts(found, path), "parity": deviation}


def load_policy(policy: str | Path, *, robot: str | Path | None = None) -> "Policy":
    """Return a policy, whose `act` returns base commands of shape (n, action size), in [-1, 1].

    Example: `kinfeas.load_policy("pretrained", robot="tiago").act`

    Raises:
        KinfeasError: If there is no such policy, or it is broken or for another robot.
    """
    from kinfeas.policies import loading

    name = str(policy)
    known = options.read_robot(_name(robot) or options.robot_of(name))
    return loading.load_policy(name, known)


def _name(value: str | Path | None) -> str | None:
    return None if value is None else str(value)
