"""The learning curve of a run: success over time and steps."""

import csv
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.viz.pictures.style import BASE, EE, FAINT, INK, STYLE

_PLOTTED = ("steps", "seconds", "train/success", "evaluation/success")


def read_metrics(run: Path) -> dict[str, Array]:
    """Return the columns of a run's `metrics.csv` that are drawn, NaN where a row has no entry.

    Raises:
        KinfeasError: If the file is missing, empty or broken.
    """
    path = run / "metrics.csv"
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        columns = {key: np.array([float(row[key] or "nan") for row in rows]) for key in rows[0]}
        columns = {key: columns[key] for key in _PLOTTED}
    except (OSError, ValueError, TypeError, LookupError) as error:
        raise KinfeasError(f"{path}: no table of training metrics") from error
    return columns


def learning_curve(metrics: Mapping[str, Array], levels: Mapping[str, float]) -> Figure:
    """Return the picture of success over time and steps.

    Args:
        metrics: Columns of `metrics.csv`.
        levels: Shares in 0-1 to compare with, each drawn as a line with its name.
    """
    minutes, steps = metrics["seconds"] / 60.0, metrics["steps"]
    with rc_context(STYLE):
        figure = Figure(figsize=(8.6, 4.4), layout="constrained")
        axes = figure.subplots()
        axes.plot(
            minutes, metrics["train/success"], color=BASE, alpha=0.55, lw=1.8,
            label="training episodes: exploring, with noise",
        )  # fmt: skip
        judged = np.isfinite(metrics["evaluation/success"])
        axes.plot(
            minutes[judged], metrics["evaluation/success"][judged], "o-", color=EE, lw=2.2, ms=7,
            mec="white", clip_on=False, zorder=4,
            label="evaluation: as deployed",
        )  # fmt: skip
        axes.set(xlabel="training time (min)", ylabel="episodes without a failure")
        axes.set_xlim(0.0, float(minutes[-1]))
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        _draw_levels(axes, levels)
        _add_steps(axes, minutes, steps)
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.14), ncols=2, borderaxespad=0.2)
    return figure


def apart(values: Sequence[float], gap: float) -> list[float]:
    """Return ascending `values` moved up as little as keeps them `gap` apart."""
    placed: list[float] = []
    for value in values:
        placed.append(max(value, placed[-1] + gap) if placed else value)
    return placed


def _draw_levels(axes: Axes, levels: Mapping[str, float]) -> None:
    """Draw horizontal lines, their names beside the axes and apart from each other."""
    ordered = sorted(levels.items(), key=lambda item: item[1])
    for (name, value), y in zip(ordered, apart([v for _, v in ordered], 0.055), strict=True):
        axes.axhline(value, color=FAINT, lw=1.1, ls=(0, (5, 3)), zorder=1.5)
        axes.annotate(
            f"{name} {value:.1%}", (1.0, value), xytext=(1.015, y), va="center", fontsize=9,
            xycoords=("axes fraction", "data"), textcoords=("axes fraction", "data"), color=INK,
            annotation_clip=False,
        )  # fmt: skip


def _add_steps(axes: Axes, minutes: Array, steps: Array) -> None:
    """Write the environment steps made by each minute that is marked below along the top."""
    above = axes.secondary_xaxis("top")
    above.xaxis.set_major_formatter(
        _Once(lambda x, _: f"{np.interp(x, minutes, steps, left=0.0) / 1000.0:,.0f} k")
    )
    above.set_xlabel("environment steps")


class _Once(FuncFormatter):
    """Leaves out a label that equals the one before: no step is made while a policy is judged."""

    def format_ticks(self, values: list[float]) -> list[str]:
        labels = super().format_ticks(values)
        return [now if now != before else "" for before, now in pairwise(["", *labels])]
