"""`kinfeas demo`: train, evaluate and report, in a few minutes."""

import json
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, share, write_json
from kinfeas.cli.train import train_run
from kinfeas.cli.train_settings import Wishes, read_settings
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.benchmark.comparison import Comparison
    from kinfeas.training.config import TrainConfig
    from kinfeas.viz.report import Report

PICTURES = ("learning_curve.png", "episodes.png")
"""What the pictures of the report are called beside it."""


def demo(
    robot: options.RobotName = "pr2",
    minutes: Annotated[float, typer.Option("--minutes", help="Minutes to train for.")] = 2.0,
    seed: options.Seed = 0,
    episodes: options.Episodes = 500,
    out: Annotated[
        Path, typer.Option("--out", help="Folder of the run; numbered on if it is taken.")
    ] = Path("runs/demo"),
    overrides: options.Overrides = None,
) -> None:
    """Train a base policy, evaluate it on fresh episodes and write a report: under five minutes.

    Settings are those of [bold]kinfeas train[/].
    """
    options.check_robot(robot)
    from kinfeas.benchmark.comparison import compare, make_report
    from kinfeas.evaluation.evaluate import EvalConfig
    from kinfeas.io.files import write_file
    from kinfeas.viz.report import write_report

    settings = read_settings(Wishes(robot, None, seed, minutes), None, overrides or [])
    folder = free_folder(out)
    train_run(settings, folder)
    task = options.read_task(settings.task, settings.task_parameters)
    # Not the seed of training, whose episodes the policy has seen.
    trial = EvalConfig(options.read_robot(settings.robot), task, episodes, settings.seed + 1)
    with progress("evaluating") as advance:
        comparison = compare(trial, folder, _processes(), advance)
    write_json(comparison.policy, folder / "evaluation.json")
    said = {"robot": robot, "minutes": minutes, "seed": seed, "episodes": episodes, "out": folder}
    again = _line("demo", said, overrides or [])
    report = make_report(comparison, [again, *_commands(comparison, settings)])
    for name, picture in zip(PICTURES, report.pictures, strict=True):
        write_file(folder / name, picture.png)
    write_report(report, folder / "report.html")
    _show(report)
    typer.echo(f"report: {folder / 'report.html'}")


def free_folder(wanted: Path) -> Path:
    """Return `wanted`, or with the first number from 2 on that makes a folder not there yet.

    Raises:
        KinfeasError: If it ends in no name that a number can follow.
    """
    if wanted.name in ("", ".."):
        raise KinfeasError(f"--out: must end in the name of a folder, not {str(wanted)!r}")
    folder, number = wanted, 1
    while folder.exists():
        number += 1
        folder = wanted.parent / f"{wanted.name}-{number}"
    if folder != wanted:
        sys.stderr.write(f"{wanted} is there already: this run goes to {folder}\n")
    return folder


def _processes() -> int:
    return min(2, os.cpu_count() or 1)


def _commands(comparison: "Comparison", settings: "TrainConfig") -> list[str]:
    """Return the lines that make each figure of the report again."""
    trial, policies = comparison.trial, (str(comparison.run), *comparison.baselines)
    same: dict[str, object] = {"robot": settings.robot, "task": settings.task}
    same |= {"episodes": trial.episodes, "seed": trial.seed}
    changes = [f"task.{key}={json.dumps(value)}" for key, value in settings.task_parameters.items()]
    judged = [_line("evaluate", {**same, "policy": policy}, changes) for policy in policies]
    return [*judged, _line("ceiling", same, changes)]


def _line(command: str, said: Mapping[str, object], overrides: Sequence[str]) -> str:
    """Return a line for the shell: the command, its options by their names, and settings."""
    words = ["kinfeas", command]
    words += [word for name, value in said.items() for word in (f"--{name}", str(value))]
    return shlex.join([*words, *(word for text in overrides for word in ("--set", text))])


def _show(report: "Report") -> None:
    rows = []
    for row in report.rows:
        low, high = row.success.low, row.success.high
        interval = (low, high) if low < high else (None, None)
        rows.append([row.name, share(row.success.value, *interval)])
    print_table(report.title, ["", "without a failure (95 % interval)"], rows)
