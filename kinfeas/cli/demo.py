"""`kinfeas demo`: train, evaluate and report, in a few minutes."""

import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, share, write_json
from kinfeas.cli.train import Wishes, read_settings, train_run

if TYPE_CHECKING:
    from kinfeas.evaluation.comparison import Comparison
    from kinfeas.evaluation.report import Report

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
    from kinfeas.evaluation.comparison import compare, make_report
    from kinfeas.evaluation.evaluate import Trial
    from kinfeas.evaluation.report import write_report
    from kinfeas.files import write_file

    settings = read_settings(Wishes(robot, None, seed, minutes), None, overrides or [])
    folder = free_folder(out)
    train_run(settings, folder)
    task = options.read_task(settings.task, settings.task_parameters)
    # Not the seed of training, whose episodes the policy has seen.
    trial = Trial(options.read_robot(robot), task, episodes, seed + 1)
    with progress("evaluating") as advance:
        comparison = compare(trial, folder, _processes(), advance)
    write_json(comparison.policy, folder / "evaluation.json")
    started = [
        "kinfeas",
        "demo",
        "--robot",
        robot,
        "--minutes",
        f"{minutes:g}",
        "--seed",
        f"{seed}",
    ]
    started += [part for text in overrides or [] for part in ("--set", text)]
    report = make_report(comparison, _commands(comparison, started))
    for name, picture in zip(PICTURES, report.pictures, strict=True):
        write_file(folder / name, picture.png)
    write_report(report, folder / "report.html")
    _show(report)
    typer.echo(f"report: {folder / 'report.html'}")


def free_folder(wanted: Path) -> Path:
    """Return `wanted`, or with the first number from 2 on that makes a folder not there yet."""
    folder, number = wanted, 1
    while folder.exists():
        number += 1
        folder = wanted.parent / f"{wanted.name}-{number}"
    if folder != wanted:
        sys.stderr.write(f"{wanted} is there already: this run goes to {folder}\n")
    return folder


def _processes() -> int:
    return min(2, os.cpu_count() or 1)


def _commands(comparison: "Comparison", started: list[str]) -> list[str]:
    """Return the lines that make the run and each figure of the report again."""
    trial, robot = comparison.trial, started[started.index("--robot") + 1]
    same = f"--robot {shlex.quote(robot)} --task {trial.task.name} --episodes {trial.episodes}"
    same += f" --seed {trial.seed}"
    policies = (shlex.quote(str(comparison.run)), *comparison.baselines)
    judged = [f"kinfeas evaluate {same} --policy {policy}" for policy in policies]
    return [shlex.join(started), *judged, f"kinfeas ceiling {same}"]


def _show(report: "Report") -> None:
    rows = []
    for row in report.rows:
        low, high = row.success.low, row.success.high
        interval = (low, high) if low < high else (None, None)
        rows.append([row.name, share(row.success.value, *interval)])
    print_table(report.title, ["", "without a failure (95 % interval)"], rows)
