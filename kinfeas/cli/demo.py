"""`kinfeas demo`: train, evaluate and report within minutes."""

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path

import typer

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import percent, print_table, progress, write_json
from kinfeas.cli.train import train_run
from kinfeas.config import Settings, to_options
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

PICTURES = ("learning_curve.png", "episodes.png")


def demo(
    robot: options.RobotName = DEFAULT_ROBOT,
    minutes: float = option(2.0, "Minutes of training."),
    seed: options.Seed = 0,
    episodes: options.Episodes = 500,
    out: Path = option(Path("runs/demo"), "Folder of the run; numbered if it exists."),
    overrides: options.Overrides = None,
) -> None:
    """Train, evaluate and report within five minutes.

    Settings are those of kinfeas train.

    Example: kinfeas demo --robot hsr --minutes 3 --out runs/hsr_demo
    """
    require("torch", "stable_baselines3", "matplotlib")
    from kinfeas.api import counter
    from kinfeas.api.train import configure
    from kinfeas.evaluation.evaluate import EvalConfig
    from kinfeas.io.files import write_file
    from kinfeas.policies.loading import QUICK_BASELINES
    from kinfeas.robots.loading import load_robot
    from kinfeas.tasks.loading import load_task
    from kinfeas.tasks.task import StreamTask
    from kinfeas.viz.report import compare, write_report

    changes = options.read_settings(overrides)
    settings = configure(robot, seed=seed, minutes=minutes, settings=changes)
    task = load_task(settings.task, settings.task_parameters)
    if isinstance(task, StreamTask):
        raise KinfeasError(f"task {task.name!r} has no goal; use kinfeas train and evaluate")
    folder = free_folder(out)
    train_run(settings, folder)
    # Another seed than that of training, whose episodes the policy has seen.
    config = EvalConfig(load_robot(settings.robot), task, episodes, settings.seed + 1)
    again = {"robot": robot, "minutes": minutes, "seed": seed, "episodes": episodes, "out": folder}
    same = {"robot": settings.robot, "task": settings.task, "episodes": episodes}
    same |= {"seed": config.seed}
    parameters = {f"task.{key}": value for key, value in settings.task_parameters.items()}
    commands = [_line("demo", again, changes)]
    for policy in (folder, *QUICK_BASELINES):
        commands.append(_line("evaluate", {**same, "policy": policy}, parameters))
    commands.append(_line("ceiling", same, parameters))
    with progress() as on_progress:
        count = counter(on_progress, "evaluating")
        metrics, report = compare(config, folder, commands, min(2, os.cpu_count() or 1), count)
    write_json(metrics, folder / "evaluation.json")
    for name, picture in zip(PICTURES, report.pictures.values(), strict=True):
        write_file(folder / name, picture)
    write_report(report, folder / "report.html")
    rows = []
    for row in report.rows:
        low, high = row.success.low, row.success.high
        interval = (low, high) if low < high else (None, None)
        rows.append([row.name, percent(row.success.value, *interval)])
    print_table(report.title, ["", "without a failure (95 % interval)"], rows)
    typer.echo(f"report: {folder / 'report.html'}")


def free_folder(path: Path) -> Path:
    """Return `path`, or with a number from 2 on if the folder exists."""
    if path.name in ("", ".."):
        raise KinfeasError(f"--out must end in the name of a folder, not {str(path)!r}")
    folder, number = path, 1
    while folder.exists():
        number += 1
        folder = path.parent / f"{path.name}-{number}"
    if folder != path:
        sys.stderr.write(f"{path} exists: the run is in {folder}\n")
    return folder


def _line(command: str, values: Mapping[str, object], settings: Settings) -> str:
    words = [word for name, value in values.items() for word in (f"--{name}", str(value))]
    return shlex.join(["kinfeas", command, *words, *to_options(settings)])
