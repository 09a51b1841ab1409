"""`kinfeas demo`: train, evaluate and report within minutes."""

import base64
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib.metadata import version
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

_HEADS = (
    "", "without a failure", "95 % interval", "within 5 cm", "failures", "EE deviation",
    "arm jumps",
)  # fmt: skip
_VERSIONS = ("kinfeas", "numpy", "numba", "torch", "stable-baselines3")
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#2b2f36;max-width:1100px;margin:2.5rem auto;
padding:0 1.5rem}
.note,figcaption,dt,th{color:#6b727d;font-size:.9rem}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
tr{border-bottom:1px solid #e3e6ea}th,td{text-align:right;padding:.4rem .6rem}
th:first-child,td:first-child{text-align:left}tr:nth-child(2){background:#eef6f2}
figure{margin:2rem 0}img{max-width:100%}pre{background:#f5f6f8;padding:1rem;overflow-x:auto}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1.2rem;font-size:.9rem}
dd{margin:0}
"""


def demo(
    robot: options.RobotName = DEFAULT_ROBOT,
    steps: int = option(1_200_000, "Environment steps of training."),
    seed: options.Seed = 0,
    episodes: options.Episodes = 500,
    out: Path = option(Path("runs/demo"), "Folder of the run; numbered if it exists."),
    overrides: options.Overrides = None,
) -> None:
    """Train, evaluate and report, within minutes.

    Settings are those of kinfeas train.

    Example: kinfeas demo --robot hsr --steps 2000000 --out runs/hsr_demo
    """
    require("torch", "stable_baselines3", "matplotlib")
    from kinfeas.api.train import configure
    from kinfeas.core.files import write_file
    from kinfeas.envs.world import evaluation_world
    from kinfeas.evaluation.evaluate import EvalConfig
    from kinfeas.robots.loading import load_robot
    from kinfeas.tasks.loading import load_task
    from kinfeas.tasks.task import StreamTask

    changes = options.read_settings(overrides)
    settings = configure(robot, seed=seed, steps=steps, settings=changes)
    task = load_task(settings.task, settings.task_parameters)
    if isinstance(task, StreamTask):
        raise KinfeasError(f"task {task.name!r} has no goal; use kinfeas train and evaluate")
    folder = free_folder(out)
    train_run(settings, folder)
    # Not the seed of the training, with whose episodes the policy was trained.
    world = replace(evaluation_world(), filters=())
    config = EvalConfig(load_robot(settings.robot), task, episodes, settings.seed + 1, world=world)
    results = _evaluated(config, folder)
    arguments = {"robot": robot, "steps": steps, "seed": seed, "episodes": episodes, "out": folder}
    common = {"robot": settings.robot, "task": settings.task, "episodes": episodes}
    common |= {"seed": config.seed}
    parameters = {f"task.{key}": value for key, value in settings.task_parameters.items()}
    commands = [_line("demo", arguments, changes)]
    for result in results:
        specific = {"policy": result["policy"], "filters": "none"}
        commands.append(_line("evaluate", {**common, **specific}, parameters))
    commands.append(_line("ceiling", common, parameters))
    pictures = _pictures(config, folder, results)
    write_json(results[0], folder / "evaluation.json")
    for name, picture in zip(PICTURES, pictures.values(), strict=True):
        write_file(folder / name, picture)
    write_file(folder / "report.html", _page(results, pictures, commands).encode())
    rows = [row[:3] for row in _rows(results)]
    print_table(f"{config.robot.name} on {task.name}, without filters", _HEADS[:3], rows)
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
    """Return PNG files by caption: the learning curve, and the first episodes, not the best."""
    from kinfeas.benchmark.evaluations import read_run
    from kinfeas.benchmark.pictures import curves_figure
    from kinfeas.envs.world import World
    from kinfeas.policies.loading import load_policy
    from kinfeas.viz.episodes import episodes_figure
    from kinfeas.viz.replay import record_episodes
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
    """Return `path`, with a number from 2 on appended if the folder exists."""
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


def _rows(results: "Sequence[Summary]") -> list[list[str]]:
    """Return rows for the trained policy, the baselines, the ceiling and the paper's figures."""
    from kinfeas.benchmark.table import LEARNED, paper_figures

    rows = [
        [
            result["policy"],
            f"{result['success']:.1%}",
            f"{result['success_low']:.1%} - {result['success_high']:.1%}",
            f"{result['within_5cm']:.1%}",
            f"{result['ik_failures_per_episode']:.2f}",
            f"{1000.0 * result['mean_deviation_m']:.1f} mm",
            f"{result['joint_jumps_per_episode']:.2f}",
        ]
        for result in results
    ]
    trained = results[0]
    rows[0][0] = "trained policy"
    low, high = trained["ceiling_low"], trained["ceiling_high"]
    rows.append(["ceiling", f"{trained['ceiling']:.1%}", f"{low:.1%} - {high:.1%}"])
    paper = paper_figures(trained["robot"], trained["task"])
    for key, name in ((LEARNED, "learned policy"), ("follow_ee", "follow_ee")):
        if key in paper:
            rows.append([f"paper: {name}", f"{paper[key].success:.1%}"])
    return rows


def _page(
    results: "Sequence[Summary]", pictures: Mapping[str, bytes], commands: Sequence[str]
) -> str:
    """Return an HTML page that compares a trained policy with its ceiling and baselines.

    `pictures` are PNG files by caption, `commands` reproduce the page.
    """
    trained, *baselines = results
    episodes, seed = trained["episodes"], trained["seed"]
    title = f"A base policy for {trained['robot']} on {trained['task']}"
    summary = (
        f"The policy completes {trained['success']:.1%} of {episodes} fresh episodes without an IK "
        f"failure, the better baseline {max(result['success'] for result in baselines):.1%}. At "
        f"most {trained['ceiling']:.1%} of the goals are reachable."
    )
    notes = (
        f"Episodes 0 to {episodes - 1} of seed {seed} in all rows except the paper's, which come "
        "from its own program. Intervals are Wilson's.",
        "All policies act without command filters. Ceiling: goals that the end-effector reaches "
        "from some base pose.",
    )
    figures = "".join(
        f"<figure><img src='data:image/png;base64,{base64.b64encode(content).decode()}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>\n"
        for caption, content in pictures.items()
    )
    lines = [
        "".join(f"<td>{escape(cell)}</td>" for cell in [*row, *[""] * (len(_HEADS) - len(row))])
        for row in _rows(results)
    ]
    facts = {"machine": f"{platform.platform()}, {os.cpu_count()} cores"}
    facts |= {"Python": platform.python_version(), **{name: version(name) for name in _VERSIONS}}
    return (
        "<!doctype html>\n<html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style>\n"
        f"<h1>{escape(title)}</h1><p>{escape(summary)}</p>\n"
        f"<table><tr>{''.join(f'<th>{head}</th>' for head in _HEADS)}</tr>\n"
        f"{''.join(f'<tr>{line}</tr>{chr(10)}' for line in lines)}</table>\n"
        f"{''.join(f'<p class=note>{note}</p>' for note in notes)}\n{figures}\n"
        f"<h2>Commands</h2><pre>{escape(chr(10).join(commands))}</pre>\n<h2>Versions</h2><dl>"
        f"{''.join(f'<dt>{key}</dt><dd>{escape(value)}</dd>' for key, value in facts.items())}"
        "</dl>\n</html>\n"
    )
