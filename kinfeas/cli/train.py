"""`kinfeas train`: train a base policy."""

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import minutes as as_minutes
from kinfeas.cli.output import percent, print_table, progress
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.api.train import OnTraining, Run
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.run import Progress


def train(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: Annotated[
        str | None, options.robot_option("  [default: robot of --config or --init, else pr2]")
    ] = None,
    task: Annotated[str | None, options.task_option(default="  [default: ggr]")] = None,
    seed: Annotated[int | None, option("Random seed.  [default: 0]")] = None,
    minutes: Annotated[
        float | None, option("Time; in the analytic world without evaluations.  [default: 3]")
    ] = None,
    steps: Annotated[
        int | None, option("Environment steps, in place of or beside --minutes.")
    ] = None,
    adapters: options.AdapterList = None,
    world: options.World = "analytic",
    init: Annotated[
        str | None, option("Policy to start from: a run folder, or pretrained.")
    ] = None,
    processes: Annotated[int | None, option("Processes of a physics world.  [default: 2]")] = None,
    out: Annotated[
        Path | None, option("Folder of the run.  [default: runs/ROBOT-TASK-SEED]")
    ] = None,
    config: Annotated[
        str | None,
        option(
            "Recipe: a YAML file, or a name such as train_rooms or paper/pr2.  "
            "[default: that of the robot]"
        ),
    ] = None,
    overrides: options.Overrides = None,
    resume: Annotated[
        Path | None, option("Resume the run of a folder; --minutes and --steps extend.")
    ] = None,
) -> None:
    """Train a base policy. Ctrl-C leaves a checkpoint to --resume from.

    Recipes are sections of the robot: train, with --world pybullet or mujoco train_physics,
    with --init as well finetune_physics. Settings: every key of the recipe, such as
    learner.batch_size=256.

    A resumed run equals one that was never interrupted. Only in PyBullet, and with several
    processes, episodes in progress restart.

    Example: kinfeas train --robot pr2 --minutes 3 --out runs/pr2

    Example: kinfeas train --resume runs/pr2
    """
    require("torch", "stable_baselines3")
    from kinfeas.api import train as training

    if resume is None:
        settings = training.configure(
            robot, task=task, seed=seed, minutes=minutes, steps=steps,
            adapters=adapters, world=world, init=init, processes=processes, config=config,
            settings=options.read_settings(overrides),
        )  # fmt: skip
        run = train_run(settings, out or training.default_folder(settings))
    else:
        others = (robot, task, seed, adapters, init, processes, out, config, overrides)
        if world != "analytic" or any(other is not None for other in others):
            raise KinfeasError("--resume excludes all options but --minutes and --steps")
        with _resumable(resume), training_bar() as report:
            run = training.resume(resume, minutes=minutes, steps=steps, on_progress=report)
    _show(run)


def train_run(config: "TrainConfig", folder: Path) -> "Run":
    """Train with a progress bar and return the run."""
    from kinfeas.api.train import begin

    with _resumable(folder), training_bar() as report:
        return begin(config, folder, report)


@contextmanager
def _resumable(folder: Path) -> Iterator[None]:
    """End with code 130 on Ctrl-C, and print how the run continues."""
    from kinfeas.training.run import SETTINGS

    try:
        yield
    except KeyboardInterrupt:
        resume = shlex.join(["kinfeas", "train", "--resume", str(folder)])
        sys.stderr.write(
            f"interrupted; resume with: {resume}\n"
            if (folder / SETTINGS).is_file()
            else "interrupted before the run began\n"
        )
        raise typer.Exit(130) from None


@contextmanager
def training_bar() -> Iterator["OnTraining"]:
    """Show a bar on standard error, lines where it is no terminal; yields its update."""
    with progress("training") as advance:
        reported = 0.0

        def report(now: "Progress") -> None:
            nonlocal reported
            advance(now.fraction - reported, describe(now))
            reported = now.fraction

        yield report


def describe(now: "Progress") -> str:
    """Return steps, speed, success, best evaluation and remaining time of a run in one line."""
    if now.evaluating is not None:
        done, episodes = now.evaluating
        return f"{now.steps:,} steps, evaluating {done}/{episodes} episodes"
    left = now.seconds * (1.0 - now.fraction) / max(now.fraction, 1e-9)
    # NaN and -1 mean unknown.
    recent = f"{now.success:.0%}" if now.success >= 0.0 else "-"
    best = f", best evaluation {now.best:.1%} (mean of success and within 5 cm)"
    return (
        f"{now.steps:,} steps, {now.steps / max(now.seconds, 1e-9):,.0f}/s, "
        f"success while learning {recent}{best if now.best >= 0.0 else ''}, "
        f"{as_minutes(left)} left"
    )


def _show(run: "Run") -> None:
    from kinfeas.api.train import evaluation_options
    from kinfeas.config import to_options

    best, folder = run.metrics, str(run.folder)
    rows = [
        ["steps", f"{run.steps:,}"],
        ["time of training", f"{run.seconds / 60.0:.1f} min"],
        ["time of evaluations during training", f"{run.evaluation_seconds / 60.0:.1f} min"],
        ["steps per second of training", f"{run.steps / run.seconds:,.0f}"],
        [
            f"success of the best checkpoint, {best['episodes']} fresh episodes"
            + (f", with {', '.join(best['adapters'])}" if best["adapters"] else ""),
            percent(*(float(best[key]) for key in ("success", "success_low", "success_high"))),
        ],
        ["steps of the best checkpoint", f"{best['steps']:,}"],
    ]
    print_table(f"trained: {folder}", ["", "share (95 % interval) or figure"], rows)
    command = ["kinfeas", "evaluate", "--robot", best["trained_with"], "--task", best["task"]]
    command += ["--world", best["world"]] if best["world"] != "analytic" else []
    adapters, settings = evaluation_options(run.folder)
    command += ["--policy", folder, *(["--adapters", adapters] if adapters else [])]
    typer.echo(f"evaluate it: {shlex.join([*command, *to_options(settings)])}")
