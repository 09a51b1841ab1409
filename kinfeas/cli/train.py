"""`kinfeas train`: train a base policy."""

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinfeas.cli import options
from kinfeas.cli.output import minutes as as_minutes
from kinfeas.cli.output import print_table, progress, share, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.run import Progress
    from kinfeas.training.train import Report


def train(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: Annotated[
        str | None,
        options.robot_option("  [default: robot of --config or --init, else pr2]"),
    ] = None,
    task: Annotated[str | None, options.task_option(default="  [default: ggr]")] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed.  [default: 0]")] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help="Time; in the analytic world without evaluations.  [default: 3]"),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="Environment steps, in place of or beside --minutes.")
    ] = None,
    adapters: options.AdapterList = None,
    world: options.World = "analytic",
    init: Annotated[
        str | None, typer.Option(help="Policy to start from: a run folder, or pretrained.")
    ] = None,
    processes: Annotated[
        int | None, typer.Option(help="Processes of a physics world.  [default: 2]")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run.  [default: runs/ROBOT-TASK-SEED]")
    ] = None,
    config: Annotated[
        str | None,
        typer.Option(
            help="Recipe: a YAML file, or a name such as train/tiago or paper/pr2.  "
            "[default: that of the robot]"
        ),
    ] = None,
    overrides: options.Overrides = None,
    resume: Annotated[
        Path | None, typer.Option(help="Resume the run of a folder; --minutes and --steps extend.")
    ] = None,
) -> None:
    """Train a base policy. Ctrl-C leaves a checkpoint to --resume from.

    Recipes are sections of configs/robots: train, with --world pybullet or mujoco train_physics,
    with --init as well finetune_physics. Settings: every key of the recipe, such as
    learner.batch_size=256.

    A resumed run equals one that was never interrupted. Only in PyBullet, and with several
    processes, episodes in progress restart.

    Example: kinfeas train --robot pr2 --minutes 3 --out runs/pr2

    Example: kinfeas train --resume runs/pr2
    """
    from kinfeas.training.run import check_begun, check_new, finished

    require("torch", "stable_baselines3")
    if resume is not None:
        others = (robot, task, seed, adapters, init, processes, out, config, overrides)
        if world != "analytic" or any(one is not None for one in others):
            raise KinfeasError("--resume excludes all options but --minutes and --steps")
        check_begun(resume)
        longer = _duration(minutes, steps)
        folder, done = resume, finished(resume, longer)
        if done is None:
            from kinfeas.training.train import resume as continue_run

            done = _run(resume, lambda report: continue_run(resume, report, longer))
        else:
            sys.stderr.write(f"{folder}: finished; larger --steps or --minutes extend the run\n")
    else:
        if out is not None:
            check_new(out)
        settings = read_settings(
            robot, task, seed=seed, minutes=minutes, steps=steps,
            adapters=adapters, world=world, init=init, processes=processes, config=config,
            overrides=overrides or (),
        )  # fmt: skip
        folder = out or default_folder(settings)
        done = train_run(settings, folder)
    _show(done, folder)


def read_settings(  # noqa: PLR0913 - options of the command
    robot: str | None = None,
    task: str | None = None,
    *,
    seed: int | None = None,
    minutes: float | None = None,
    steps: int | None = None,
    adapters: str | None = None,
    world: str = "analytic",
    init: str | None = None,
    processes: int | None = None,
    config: str | None = None,
    overrides: Sequence[str] = (),
) -> "TrainConfig":
    """Return the settings of a run: the recipe, then the options, then `overrides`."""
    from kinfeas.core.registry import from_anywhere
    from kinfeas.envs.world import World
    from kinfeas.training.config import load_recipe
    from kinfeas.training.run import with_initial_policy

    given: dict[str, object] = {"robot": robot, "task": task, "seed": seed, "init": init}
    given |= {"processes": processes}
    if adapters is not None:
        given |= options.adapters_of_world(adapters)
        given["evaluation_adapters"] = given["world.adapters"]
    changes = [*options.assignments(options.given(given)), *_duration(minutes, steps), *overrides]
    settings = load_recipe(
        config, changes, backend=world, robot=options.robot_of(None if robot else init)
    )
    if settings.world.backend != world:
        raise KinfeasError(f"--world {world}: the recipe is for the world {settings.world.backend}")
    # Before there is a folder, since it raises the errors of unknown names.
    known_task = options.read_task(settings.task, settings.task_parameters)
    World(options.read_robot(settings.robot), known_task, settings.world, settings.seed).close()
    return with_initial_policy(
        replace(settings, robot=from_anywhere(settings.robot), task=from_anywhere(settings.task))
    )


def _duration(minutes: float | None, steps: int | None) -> list[str]:
    """Return assignments of the duration; one that is given lifts the recipe's other limit."""
    if minutes is None and steps is None:
        return []
    limits = {"minutes": minutes, "steps": steps}
    return [f"schedule.{key}={'null' if one is None else one}" for key, one in limits.items()]


def default_folder(settings: "TrainConfig") -> Path:
    """Return `runs/ROBOT-TASK-SEED`, with its engine appended for a run with physics."""
    robot, task = Path(settings.robot).stem, Path(settings.task).stem
    backend = settings.world.backend
    suffix = "" if backend == "analytic" else f"-{backend}"
    return Path("runs") / f"{robot}-{task}-{settings.seed}{suffix}"


def train_run(settings: "TrainConfig", folder: Path) -> "Progress":
    """Train with a progress bar and return the progress at the end."""
    from kinfeas.training.train import train as run

    return _run(folder, lambda report: run(settings, folder, report))


def _run(folder: Path, work: Callable[["Report"], "Progress"]) -> "Progress":
    from kinfeas.training.run import SETTINGS

    try:
        with training_bar() as report:
            return work(report)
    except KeyboardInterrupt:
        resume = shlex.join(["kinfeas", "train", "--resume", str(folder)])
        sys.stderr.write(
            f"interrupted; resume with: {resume}\n"
            if (folder / SETTINGS).is_file()
            else "interrupted before the run began\n"
        )
        raise typer.Exit(130) from None


@contextmanager
def training_bar() -> Iterator["Report"]:
    """Show a bar on standard error, lines where it is no terminal; yields its update."""
    with progress("training") as advance:
        shown = 0.0

        def report(now: "Progress") -> None:
            nonlocal shown
            advance(now.share - shown, describe(now))
            shown = now.share

        yield report


def describe(now: "Progress") -> str:
    """Return steps, speed, success, best evaluation and remaining time of a run in one line."""
    if now.evaluating is not None:
        done, episodes = now.evaluating
        return f"{now.steps:,} steps, evaluating {done}/{episodes} episodes"
    left = (now.seconds + now.other_seconds) * (1.0 - now.share) / max(now.share, 1e-9)
    # NaN and -1 mean unknown.
    recent = f"{now.success:.0%}" if now.success >= 0.0 else "-"
    best = f", best evaluation {now.best:.1%} (mean of success and within 5 cm)"
    return (
        f"{now.steps:,} steps, {now.steps / max(now.seconds, 1e-9):,.0f}/s, "
        f"success while learning {recent}{best if now.best >= 0.0 else ''}, "
        f"{as_minutes(left)} left"
    )


def write_evaluation(folder: Path) -> dict[str, Any]:
    """Write `evaluation.json` of a finished run and return its metrics on fresh episodes."""
    from kinfeas.training.run import read_evaluation

    metrics = read_evaluation(folder)
    write_json(metrics, folder / "evaluation.json")
    return metrics


def _show(done: "Progress", folder: Path) -> None:
    from kinfeas.config.recipes import recipes
    from kinfeas.control.assemble import FOLDER, read_sim2real
    from kinfeas.evaluation import evaluate
    from kinfeas.training import run as training_run

    best = write_evaluation(folder)
    rows = [
        ["steps", f"{done.steps:,}"],
        ["time of training", f"{done.seconds / 60.0:.1f} min"],
        [
            "time of evaluations during training",
            f"{done.parts.get('evaluation', 0.0) / 60.0:.1f} min",
        ],
        ["steps per second of training", f"{done.steps / done.seconds:,.0f}"],
        [
            f"success of the best checkpoint, {best['episodes']} fresh episodes"
            + (f", with {', '.join(best['adapters'])}" if best["adapters"] else ""),
            share(*(float(best[key]) for key in ("success", "success_low", "success_high"))),
        ],
        ["steps of the best checkpoint", f"{best['steps']:,}"],
    ]
    print_table(f"trained: {folder}", ["", "share (95 % interval) or figure"], rows)
    command = ["kinfeas", "evaluate", "--robot", best["trained_with"], "--task", best["task"]]
    command += ["--world", best["world"]] if best["world"] != "analytic" else []
    command += ["--policy", str(folder)]
    settings = training_run.read_settings(folder)
    changes = {f"task.{key}": value for key, value in settings.task_parameters.items()}
    name = options.read_robot(settings.robot).name
    usual = evaluate.read_settings(name, settings.world.backend).world
    plugins = {"filters": settings.world.filters, "adapters": settings.evaluation_adapters}
    shipped = [
        name for name in recipes(FOLDER) if read_sim2real(name).adapters == plugins["adapters"]
    ]
    if plugins["adapters"] and shipped:
        command += ["--adapters", shipped[0].partition("/")[2]]
        del plugins["adapters"]
    for key, specs in plugins.items():
        if specs != getattr(usual, key):
            changes[f"world.{key}"] = [{"name": one.name, **one.parameters} for one in specs]
    for change in options.assignments(changes):
        command += ["--set", change]
    typer.echo(f"evaluate it: {shlex.join(command)}")
