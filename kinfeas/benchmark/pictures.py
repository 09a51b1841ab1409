"""Files of a benchmark, and its pictures: success, learning curves and example episodes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from kinfeas.benchmark.config import BenchmarkConfig
from kinfeas.benchmark.evaluations import LEARNED_POLICIES, Evaluation, TrainedRun
from kinfeas.benchmark.markdown import groups, label, rows_of, title, to_markdown
from kinfeas.benchmark.table import LEARNED, Cell, paper_figures
from kinfeas.core.files import read_csv, to_json, write_file
from kinfeas.envs.world import World
from kinfeas.evaluation.evaluate import read_settings
from kinfeas.jobs.job import Result
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.replay import Recording, caption, record_episodes
from kinfeas.viz.style import BASE, EE, FAINT, GOAL, INK, STYLE, TITLES, png

_PLOTTED = ("steps", "train/success", "evaluation/success")
_CURVE_INCHES = 4.9
_BEYOND = "#e4e7eb"  # colour beyond the ceiling
_ROW_INCHES, _PANEL_INCHES = 0.27, 2.35
_LEGEND_INCHES = (7.4, 9.0)  # width of the legend: alone, and with results without physics


def table_figure(cells: Sequence[Cell], note: str = "") -> Figure:
    """Return a picture of success rates with intervals, of the paper's rates and ceilings."""
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    tables = {
        group: rows_of([cell for cell in cells if (cell.robot, cell.variant) == group])
        for group in groups(cells)
    }
    heights = [_ROW_INCHES * (len(rows) + 1.0) for rows in tables.values()]
    with_analytic = any(cell.analytic_success is not None for cell in cells)
    with rc_context(STYLE):
        width = max(_LEGEND_INCHES[with_analytic], 1.9 + _PANEL_INCHES * len(tasks))
        height = 1.1 + sum(heights) + 0.3 * len(tables)
        figure = Figure(figsize=(width, height), layout="constrained")
        panels = figure.subplots(len(tables), len(tasks), squeeze=False, height_ratios=heights)
        for line, (group, rows) in zip(panels, tables.items(), strict=True):
            names = [label(next(iter(row.values()))) for row in rows]
            for axes, task in zip(line, tasks, strict=True):
                _draw_panel(axes, [row.get(task) for row in rows], names, first=axes is line[0])
            line[0].set_title(title(*group))
        for column, task in enumerate(tasks):
            panels[0, column].set_title(task, loc="center", fontweight="normal")
            _label_lowest(list(panels[:, column]))
        legend = _table_legend(with_analytic=with_analytic)
        figure.legend(handles=legend, loc="outside lower center", ncols=6, fontsize=9.5)
        if note:
            figure.suptitle(fill(note, int(13 * width)), fontsize=9.5, x=0.01, ha="left")
    return figure


def _draw_panel(
    axes: Axes, cells: Sequence[Cell | None], names: Sequence[str], *, first: bool
) -> None:
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(len(names) - 0.45, -0.55)
    axes.set_yticks(range(len(names)), names if first else [""] * len(names))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.spines["left"].set_visible(False)
    complete = [cell for cell in cells if cell is not None]
    if not complete:  # only the names of the rows are shown
        axes.xaxis.set_visible(False)
        axes.spines["bottom"].set_visible(False)
        return
    ceiling = 100.0 * complete[0].ceiling
    axes.axvspan(ceiling, 100.0, color=_BEYOND, lw=0.0, zorder=0.5)
    axes.axvline(ceiling, color=INK, lw=1.2, ls=(0, (4, 2)), zorder=2)
    for row, cell in enumerate(cells):
        if cell is not None:
            _draw_row(axes, row, cell)


def _draw_row(axes: Axes, row: int, cell: Cell) -> None:
    value, colour = 100.0 * cell.success, EE if cell.learned else BASE
    axes.plot(
        [100.0 * cell.success_low, 100.0 * cell.success_high], [row, row],
        color=colour, lw=4.5, alpha=0.35, solid_capstyle="butt", zorder=3,
    )  # fmt: skip
    axes.plot([value], [row], "o", color=colour, ms=6.5, mec="white", mew=0.8, zorder=5,
              clip_on=False)  # fmt: skip
    if cell.analytic_success is not None:
        axes.plot([100.0 * cell.analytic_success], [row], "|", color=colour, mew=2.2, ms=11,
                  zorder=4.5, clip_on=False)  # fmt: skip
    if cell.paper_success is not None:
        axes.plot([100.0 * cell.paper_success], [row], "D", color="none", mec=GOAL, mew=1.7,
                  ms=6.5, zorder=4, clip_on=False)  # fmt: skip
    axes.annotate(
        f"{value:.1f}", (1.0, row), xytext=(9, 0), xycoords=("axes fraction", "data"),
        textcoords="offset points", va="center", fontsize=8.5, color=colour,
        fontweight="bold" if cell.learned else "normal", annotation_clip=False,
    )  # fmt: skip


def _label_lowest(panels: Sequence[Axes]) -> None:
    """Label the x axis of the lowest panel in a column that has an axis."""
    visible = [axes for axes in panels if axes.xaxis.get_visible()]
    for axes in visible[:-1]:
        axes.tick_params(axis="x", labelbottom=False)
    visible[-1].set_xlabel("success, %", fontsize=9)


def _table_legend(*, with_analytic: bool) -> list[Line2D]:
    handles = [
        Line2D([], [], color=EE, lw=0, marker="o", ms=7, label="learned"),
        Line2D([], [], color=BASE, lw=0, marker="o", ms=7, label="baseline"),
        Line2D([], [], color=BASE, lw=4.5, alpha=0.35, label="95 % interval"),
        Line2D([], [], color="none", lw=0, marker="D", mec=GOAL, mew=1.7, ms=7, label="paper"),
        Line2D([], [], color=INK, lw=1.2, ls=(0, (4, 2)),
               label="ceiling"),
    ]  # fmt: skip
    if with_analytic:
        handles.append(
            Line2D([], [], color=INK, lw=0, marker="|", mew=2.2, ms=11, label="without physics")
        )
    return handles


def curves_figure(runs: Sequence[TrainedRun], levels: Mapping[str, Mapping[str, float]]) -> Figure:
    """Return the learning curves of runs, a panel for each robot and a line for each run.

    `levels` are success rates in 0-1 to compare each robot with, by name.
    """
    robots = list(dict.fromkeys(run.robot for run in runs))
    with rc_context(STYLE):
        figure = Figure(figsize=(0.6 + _CURVE_INCHES * len(robots), 4.3), layout="constrained")
        panels = figure.subplots(1, len(robots), squeeze=False, sharey=True)[0]
        for axes, robot in zip(panels, robots, strict=True):
            for run in runs:
                if run.robot == robot:
                    _draw_curve(axes, run)
                    axes.set_title(f"{TITLES.get(robot, robot)}, {run.task}")
            _draw_levels(axes, levels.get(robot, {}))
            axes.set_xlabel("environment steps (thousands)")
            axes.set_xlim(left=0.0)
            handles, labels = axes.get_legend_handles_labels()
            unique = dict(zip(labels, handles, strict=True))
            axes.legend(unique.values(), unique, loc="upper center", bbox_to_anchor=(0.5, -0.16))
        panels[0].set_ylabel("success")
        panels[0].set_ylim(0.0, 1.02)
        panels[0].yaxis.set_major_formatter(PercentFormatter(1.0))
    return figure


def _draw_curve(axes: Axes, run: TrainedRun) -> None:
    metrics = read_csv(run.folder / "metrics.csv", _PLOTTED)
    for key, style, text in (
        ("train/success", "-", "training"),
        ("evaluation/success", "o", "evaluation, without noise"),
    ):
        measured = np.isfinite(metrics[key])
        axes.plot(
            metrics["steps"][measured] / 1000.0, metrics[key][measured], style, color=EE,
            lw=1.2, alpha=0.7, ms=5.5, mec="white", label=text,
        )  # fmt: skip


def _draw_levels(axes: Axes, levels: Mapping[str, float]) -> None:
    """Draw levels as lines across axes, with their names beside them."""
    last = -math.inf
    for name, value in sorted(levels.items(), key=lambda level: level[1]):
        last = max(value, last + 0.05)
        axes.axhline(value, color=FAINT, lw=1.1, ls=(0, (5, 3)), zorder=1.5)
        axes.text(1.015, last, f"{name} {value:.1%}", va="center", fontsize=8.5,
                  transform=axes.get_yaxis_transform())  # fmt: skip


def write_results(
    folder: Path,
    benchmark: BenchmarkConfig,
    runs: Sequence[TrainedRun],
    results: Sequence[tuple[Evaluation, Result]],
    cells: Sequence[Cell],
    command: str,
) -> list[Path]:
    """Write pictures, `table.md` and `table.json` into a folder, and return their paths.

    The pictures are `table.png`; in the analytic world also `learning_curves.png` if there are
    runs, and `examples-ROBOT.png` if there are learned policies.
    """
    pictures = {"table.png": png(table_figure(cells, benchmark.note), 110)}
    if benchmark.backend == "analytic":
        if runs:
            names = [load_robot(robot).name for robot in benchmark.robots]
            ordered = sorted(runs, key=lambda run: names.index(run.robot))
            curves = curves_figure(ordered, _levels(runs, cells))
            pictures["learning_curves.png"] = png(curves, 110)
        for robot in benchmark.robots:
            if examples := _examples(robot, [case for case, _ in results]):
                model = load_robot(robot)
                titles = [f"{task}: {caption(example)}" for task, example in examples.items()]
                figure = episodes_figure(model, list(examples.values()), titles)
                pictures[f"examples-{model.name}.png"] = png(figure, 80)
    files = dict(pictures)
    files["table.md"] = to_markdown(cells, benchmark.note, command, list(pictures)).encode()
    files["table.json"] = to_json([asdict(cell) for cell in cells]).encode()
    for name, content in files.items():
        write_file(folder / name, content)
    return [folder / name for name in files]


def _levels(runs: Sequence[TrainedRun], cells: Sequence[Cell]) -> dict[str, dict[str, float]]:
    """Return success rates by name to compare the learning curves of each robot with."""
    levels: dict[str, dict[str, float]] = {}
    trained = {run.robot: run.task for run in runs}
    for cell in cells:
        if trained.get(cell.robot) == cell.task and not cell.variant:
            levels[cell.robot] = {"ceiling": cell.ceiling}
            if paper := paper_figures(cell.robot, cell.task).get(LEARNED):
                levels[cell.robot]["paper"] = paper.success
    return levels


def _examples(robot: str, cases: Sequence[Evaluation]) -> dict[str, Recording]:
    """Return an episode of a learned policy on each task: number 0 on the first task, then 1."""
    model, examples = load_robot(robot), dict[str, Recording]()
    for case in cases:
        plain = case.robot == robot and not (case.variant or case.row)
        if plain and case.policy in LEARNED_POLICIES and case.task_name not in examples:
            config = read_settings(model.folder, case.backend, case.settings).world
            world = World(model, load_task(case.task, case.parameters), config, case.seed)
            policy = load_policy(case.source, model)
            (examples[case.task_name],) = record_episodes(world, policy, 1, first=len(examples))
    return examples
