"""`kinfeas demo`: train, evaluate and report within minutes."""

import os
import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_table, progress, write_json
from kinfeas.cli.train import train_run
from kinfeas.config import Settings, to_options
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.evaluation.evaluate import EvalConfig, Summary

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
    from kinfeas.api.train import configure
    from kinfeas.core.files import write_file
    from kinfeas.envs.world import evaluation_world
    from kinfeas.evaluation.evaluate import EvalConfig
    from kinfeas.robots.loading import load_robot
    from kinfeas.tasks.loading import load_task
    from kinfeas.tasks.task import StreamTask
    from kinfeas.viz.report import HEADS, page, rows_of

    changes = options.read_settings(overrides)
    settings = configure(robot, seed=seed, minutes=minutes, settings=changes)
    task = load_task(settings.task, settings.task_parameters)
    if isinstance(task, StreamTask):
        raise KinfeasError(f"task {task.name!r} has no goal; use kinfeas train and evaluate")
    folder = free_folder(out)
    train_run(settings, folder)
    # Another seed than that of training, whose episodes the policy has seen.
    world = replace(evaluation_world(), filters=())
    config = EvalConfig(load_robot(settings.robot), task, episodes, settings.seed + 1, world=world)
    results = _evaluated(config, folder)
    again = {"robot": robot, "minutes": minutes, "seed": seed, "episodes": episodes, "out": folder}
    same = {"robot": settings.robot, "task": settings.task, "episodes": episodes}
    same |= {"seed": config.seed}
    parameters = {f"task.{key}": value for key, value in settings.task_parameters.items()}
    commands = [_line("demo", again, changes)]
    for result in results:
        alone = {"policy": result["policy"], "filters": "none"}
        commands.append(_line("evaluate", {**same, **alone}, parameters))
    commands.append(_line("ceiling", same, parameters))
    pictures = _pictures(config, folder, results)
    write_json(results[0], folder / "evaluation.json")
    for name, picture in zip(PICTURES, pictures.values(), strict=True):
        write_file(folder / name, picture)
    write_file(folder / "report.html", page(results, pictures, commands).encode())
    rows = [row[:3] for row in rows_of(results)]
    print_table(f"{config.robot.name} on {task.name}, without filters", HEADS[:3], rows)
    typer.echo(f"report: {folder / 'report.html'}")


def _evaluated(config: "EvalConfig", run: Path) -> "list[Summary]":
    """Return the metrics of a run's policy, with the ceiling, and of baselines."""
    from kinfeas.api import counter
    from kinfeas.evaluation.evaluate import add_ceiling, evaluate
    from kinfeas.policies.loading import QUICK_BASELINES, load_policy

    results, processes = [], min(2, os.cpu_count() or 1)
    with progress() as on_progress:
        for name in (str(run), *QUICK_BASELINES):
            count = counter(on_progress, f"evaluating {name}", config.episodes)
            policy = load_policy(name, config.robot)
            results.append(evaluate(config, policy, name, processes, count))
        add_ceiling(results[:1], config, counter(on_progress, "ceiling"))
    return results


def _pictures(config: "EvalConfig", run: Path, results: "list[Summary]") -> dict[str, bytes]:
    """Return the learning curve and the first episodes, which need not be the best, by caption."""
    from kinfeas.benchmark.pictures import curves_figure
    from kinfeas.benchmark.runs import read_run
    from kinfeas.envs.world import World
    from kinfeas.evaluation.recording import record_episodes
    from kinfeas.policies.loading import load_policy
    from kinfeas.viz.episodes import episodes_figure
    from kinfeas.viz.style import png

    trained, *baselines = results
    levels = {result["policy"]: result["success"] for result in baselines}
    levels["ceiling"] = trained["ceiling"] or 0.0
    curve = curves_figure([read_run(run)], {config.robot.name: levels})
    world = World(config.robot, config.task, config.world, config.seed)
    shown = record_episodes(world, load_policy(str(run), config.robot), min(3, config.episodes))
    return {
        "Episodes without a failure during training.": png(curve),
        f"The first {len(shown)} episodes of seed {config.seed}.": png(
            episodes_figure(config.robot, shown)
        ),
    }


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
