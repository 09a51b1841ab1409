"""`kinfeas train`: learn a base policy."""

import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import completion, options
from kinfeas.cli.evaluate import WorldName
from kinfeas.cli.output import print_table, share
from kinfeas.cli.train_settings import (
    Wishes,
    best_figures,
    default_folder,
    read_settings,
    write_evaluation,
)
from kinfeas.cli.training_bar import training_bar
from kinfeas.config.quantities import LAST_SEED, MOST_PROCESSES
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.run import Progress
    from kinfeas.training.train import Report

_RECIPE = "by default the recipe's, else {}."

Minutes = Annotated[
    float | None,
    typer.Option(
        "--minutes",
        help="Minutes of training, without evaluations, more than 0; " + _RECIPE.format(3),
    ),
]
OutFolder = Annotated[
    Path | None,
    typer.Option(
        "--out",
        help="Folder of the run; by default runs/ROBOT-TASK-SEED, with physics -pybullet after it.",
    ),
]


def train(  # noqa: PLR0913, PLR0917  options of a command: typer reads them from the signature
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            help=f"{options.ROBOT_HELP[:-1]}; by default the recipe's; without --config that of "
            "--init, else pr2.",
            autocompletion=completion.plugins("robots"),
        ),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            "--task",
            help=f"{options.TASK_HELP[:-1]}; {_RECIPE.format('ggr')}",
            autocompletion=completion.plugins("tasks"),
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            max=LAST_SEED,
            help="Of all randomness, 0 or more; " + _RECIPE.format(0),
        ),
    ] = None,
    minutes: Minutes = None,
    steps: Annotated[
        int | None,
        typer.Option(
            "--steps",
            help="Environment steps in all, 1 or more, in place of the recipe's minutes; with "
            "--minutes the run ends at whichever comes first.",
        ),
    ] = None,
    algorithm: Annotated[
        str | None,
        typer.Option("--algorithm", help="What learns: sac or td3; " + _RECIPE.format("sac")),
    ] = None,
    sim2real: options.Sim2RealName = None,
    world: Annotated[
        WorldName,
        typer.Option(
            "--world",
            help="analytic: without physics; pybullet: with inertia, motors and contacts.",
        ),
    ] = WorldName.ANALYTIC,
    init: Annotated[
        str | None,
        typer.Option(
            "--init", help="Policy to go on from: the folder of a training run, or pretrained."
        ),
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option(
            "--processes",
            min=1,
            max=MOST_PROCESSES,
            help="pybullet: processes that share the environments; by default the recipe's.",
        ),
    ] = None,
    out: OutFolder = None,
    config: Annotated[
        str | None,
        typer.Option("--config", help="Recipe by name, such as train/default, or a YAML file."),
    ] = None,
    overrides: options.Overrides = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume",
            help="Go on with the run in this folder; more --minutes or --steps take it further.",
        ),
    ] = None,
) -> None:
    """Train a base policy; Ctrl-C leaves a checkpoint that --resume goes on from.

    The recipe is train/ROBOT where there is one, else train/default. With [bold]--world
    pybullet[/] it comes from the folder train_physics, with [bold]--init[/] as well from
    finetune_physics. [bold]--adapters[/] takes the place of its adapters.

    Settings: every key of the recipe, such as [bold]learner.batch_size=256[/] or
    [bold]num_envs=64[/].

    With [bold]--resume[/] only [bold]--minutes[/] and [bold]--steps[/] may be given: how long the
    run lasts in all, with what it has done.

    A resumed run in the analytic world equals one that was never stopped. With physics, learner,
    replay buffer and counters go on, but the episodes that were under way are given up for new
    ones: PyBullet's state cannot be saved.
    """
    options.check_robot(robot)
    from kinfeas.training.run import check_begun, check_new

    if processes is not None and world is WorldName.ANALYTIC:
        raise KinfeasError("--processes needs --world pybullet")
    pybullet = True if world is WorldName.PYBULLET else None
    wishes = Wishes(
        robot, task, seed, minutes, steps, algorithm, sim2real, pybullet, init, processes
    )
    if resume is not None:
        others = replace(wishes, minutes=None, steps=None)
        if any(value is not None for value in (*vars(others).values(), out, config, overrides)):
            raise KinfeasError(
                "--resume goes on with the run's own settings: leave out all others but --minutes "
                "and --steps"
            )
        check_begun(resume)
        longer = wishes.overrides()
        folder, progress = resume, _finished(resume, longer) or resume_run(resume, longer)
    else:
        if out is not None:
            check_new(out)
        settings = read_settings(wishes, config, overrides or [])
        folder = out or default_folder(settings)
        check_new(folder)
        progress = train_run(settings, folder)
    _show(progress, folder)


def _finished(folder: Path, overrides: Sequence[str]) -> "Progress | None":
    """Return how far a run came that has nothing left to do, and say so; None for any other."""
    from kinfeas.training.run import finished

    progress = finished(folder, overrides)
    if progress is not None:
        write_evaluation(folder)
        sys.stderr.write(f"{folder}: finished; more --steps or --minutes in all take it further\n")
    return progress


def train_run(settings: "TrainConfig", folder: Path) -> "Progress":
    """Train with a bar and return how far the run came."""
    from kinfeas.training.train import train as run

    return _run(folder, lambda report: run(settings, folder, report))


def resume_run(folder: Path, overrides: Sequence[str] = ()) -> "Progress":
    """Go on with a run, its settings changed by `overrides`, and return how far it came."""
    from kinfeas.training.train import resume as run

    return _run(folder, lambda report: run(folder, report, overrides))


def _run(folder: Path, work: Callable[["Report"], "Progress"]) -> "Progress":
    from kinfeas.training.run import SETTINGS

    try:
        with training_bar() as report:
            progress = work(report)
    except KeyboardInterrupt:
        begun = (folder / SETTINGS).is_file()
        resume = shlex.join(["kinfeas", "train", "--resume", str(folder)])
        sys.stderr.write(
            f"interrupted: the run is kept, go on with: {resume}\n"
            if begun
            else "interrupted before the run began: nothing was kept\n"
        )
        raise typer.Exit(130) from None
    write_evaluation(folder)
    return progress


def _show(progress: "Progress", folder: Path) -> None:
    figures = best_figures(folder)
    rows = [
        ["steps", f"{progress.steps:,}"],
        ["time", f"{progress.seconds / 60.0:.1f} min"],
        ["steps per second of training", f"{progress.steps / progress.seconds:,.0f}"],
        [
            f"best checkpoint, {figures['episodes']} fresh episodes",
            share(*(float(figures[key]) for key in ("success", "success_low", "success_high"))),
        ],
        ["it came after steps", f"{figures['steps']:,}"],
    ]
    print_table(f"trained: {folder}", ["", "share (95 % interval) or figure"], rows)
    command = ["kinfeas", "evaluate", "--robot", figures["trained_with"], "--task", figures["task"]]
    command += ["--world", figures["world"]] if figures["world"] != WorldName.ANALYTIC else []
    typer.echo(f"evaluate it: {shlex.join([*command, '--policy', str(folder)])}")
