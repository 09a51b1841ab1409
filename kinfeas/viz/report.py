"""The report of `kinfeas demo`, one self-contained HTML page: a trained policy beside baselines."""

import base64
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from kinfeas.core.metrics import Proportion
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import EvalConfig, Summary, add_ceiling, evaluate, reachability_of
from kinfeas.evaluation.paper import paper_figures
from kinfeas.evaluation.recording import record_episodes
from kinfeas.io.files import write_file
from kinfeas.policies.loading import QUICK_BASELINES, load_policy
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.plots import learning_curve, read_metrics
from kinfeas.viz.style import png

SHOWN = 3
"""Episodes in the picture: the first ones, not the best."""

_VERSIONS = ("kinfeas", "numpy", "numba", "torch", "stable-baselines3")
_COLUMNS = {
    "within_5cm": ("within 5 cm", "{:.1%}", 1.0),
    "ik_failures_per_episode": ("failures", "{:.2f}", 1.0),
    "mean_deviation_m": ("EE deviation", "{:.1f} mm", 1000.0),
    "joint_jumps_per_episode": ("arm jumps", "{:.2f}", 1.0),
}
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#2b2f36;max-width:1100px;margin:2.5rem auto}
.note,figcaption,dt,th{color:#6b727d;font-size:.9rem}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:right;padding:.4rem .6rem;border-bottom:1px solid #e3e6ea}
th:first-child,td:first-child{text-align:left}tr.ours{background:#eef6f2}
figure{margin:2rem 0}img{max-width:100%}pre{background:#f5f6f8;padding:1rem;overflow-x:auto}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1.2rem;font-size:.9rem}
dd{margin:0}
"""


@dataclass(frozen=True)
class Row:
    """A policy in the table: success, other metrics by JSON name, and whether to highlight it."""

    name: str
    success: Proportion
    metrics: Mapping[str, Any]
    ours: bool = False


@dataclass(frozen=True)
class Report:
    """Title, summary, table, notes below it, PNGs by caption, and commands that reproduce them."""

    title: str
    summary: str
    rows: Sequence[Row]
    notes: Sequence[str]
    pictures: Mapping[str, bytes]
    commands: Sequence[str]


def compare(
    config: EvalConfig,
    run: Path,
    commands: Sequence[str],
    processes: int = 1,
    on_done: Callable[[float], None] = lambda fraction: None,
) -> tuple[Summary, Report]:
    """Return the metrics of the policy of a run, and its report beside baselines and ceiling.

    `commands` reproduce the report. `on_done` is called with the fraction of all work, 0-1, that
    has just been done.
    """
    work, robot, task = 2 + len(QUICK_BASELINES), config.robot, config.task
    names = (str(run), *QUICK_BASELINES)
    policies = {name: load_policy(name, robot) for name in names}
    count = work * config.episodes
    trained, *baselines = [
        evaluate(config, policy, name, processes, lambda ended: on_done(ended / count))
        for name, policy in policies.items()
    ]
    ceiling = reachability_of(config, lambda fraction: on_done(fraction / work))
    assert ceiling is not None  # no stream of targets
    add_ceiling(trained, ceiling)
    success = _success(trained)
    levels = {metrics["policy"]: _success(metrics).value for metrics in baselines}
    rows = [Row("trained policy", success, trained, ours=True)]
    rows += [Row(metrics["policy"], _success(metrics), metrics) for metrics in baselines]
    rows.append(Row("ceiling", ceiling, {}))
    paper = paper_figures(robot.name, task.name)
    for key, name in (("policy", "paper: learned policy"), ("follow_ee", "paper: follow_ee")):
        if key in paper:
            rows.append(Row(name, Proportion(*[paper[key].success] * 3), {}))
    curve = learning_curve(read_metrics(run), {**levels, "ceiling": ceiling.value})
    world = World(robot, task, config.world, config.seed)
    recordings = record_episodes(world, policies[str(run)], min(SHOWN, config.episodes))
    return trained, Report(
        title=f"A base policy for {robot.name} on {task.name}",
        summary=(
            f"The policy completes {success.value:.1%} of {config.episodes} fresh episodes without "
            f"an IK failure, the better baseline {max(levels.values()):.1%}. At most "
            f"{ceiling.value:.1%} of the goals are reachable."
        ),
        rows=rows,
        notes=(
            f"Episodes 0 to {config.episodes - 1} of seed {config.seed} in all rows except the "
            "paper's, which come from its own program. Intervals are Wilson's.",
            "Ceiling: goals that the end-effector reaches from some base pose.",
        ),
        pictures={
            "Episodes without a failure during training.": png(curve),
            f"The first {len(recordings)} episodes of seed {config.seed}.": png(
                episodes_figure(robot, recordings)
            ),
        },
        commands=commands,
    )


def write_report(report: Report, path: Path) -> None:
    """Write a report as a self-contained HTML file."""
    heads = ["", "without a failure", "95 % interval", *(head for head, *_ in _COLUMNS.values())]
    pictures = "".join(
        f"<figure><img src='data:image/png;base64,{base64.b64encode(content).decode()}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>\n"
        for caption, content in report.pictures.items()
    )
    facts = {"machine": f"{platform.platform()}, {os.cpu_count()} cores"}
    facts |= {"Python": platform.python_version(), **{name: version(name) for name in _VERSIONS}}
    listed = "".join(f"<dt>{key}</dt><dd>{escape(value)}</dd>" for key, value in facts.items())
    html = (
        "<!doctype html>\n<html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(report.title)}</title><style>{_STYLE}</style>\n"
        f"<h1>{escape(report.title)}</h1><p>{escape(report.summary)}</p>\n"
        f"<table><tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>\n"
        f"{''.join(_line(row) for row in report.rows)}</table>\n"
        f"{''.join(f'<p class=note>{escape(note)}</p>' for note in report.notes)}\n{pictures}\n"
        f"<h2>Commands</h2><pre>{escape(chr(10).join(report.commands))}</pre>\n"
        f"<h2>Versions</h2><dl>{listed}</dl>\n</html>\n"
    )
    write_file(path, html.encode())


def _line(row: Row) -> str:
    success = row.success
    interval = f"{success.low:.1%} &ndash; {success.high:.1%}" if success.low < success.high else ""
    cells = [escape(row.name), f"<b>{success.value:.1%}</b>", interval]
    for key, (_, form, factor) in _COLUMNS.items():
        value = row.metrics.get(key)
        cells.append("" if value is None else form.format(factor * float(value)))
    kind = " class=ours" if row.ours else ""
    return f"<tr{kind}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>\n"


def _success(metrics: Summary) -> Proportion:
    return Proportion(metrics["success"], metrics["success_low"], metrics["success_high"])
