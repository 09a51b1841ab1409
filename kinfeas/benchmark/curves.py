"""Learning curves of all training seeds: mean and standard deviation, a panel for each robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from kinfeas.benchmark.runs import Run
from kinfeas.core.spatial import Array
from kinfeas.evaluation.paper import TITLES
from kinfeas.viz.plots import apart, read_metrics
from kinfeas.viz.style import BASE, EE, FAINT, INK, STYLE

_COLOURS = {"sac": EE, "td3": BASE}
_POINTS = 200
_PANEL_INCHES = 4.9


@dataclass(frozen=True, eq=False)
class Curve:
    """Success over the environment steps of several runs.

    Attributes:
        steps: Shape (k,); as far as the shortest run goes.
        mean: Over the runs, 0-1, shape (k,); NaN where not all of them have a value.
        deviation: Standard deviation over the runs, shape (k,).
    """

    steps: Array
    mean: Array
    deviation: Array


def training_curve(metrics: Sequence[Mapping[str, Array]]) -> Curve:
    """Return how success in the training episodes went, put on common steps."""
    end = min(float(one["steps"][-1]) for one in metrics)
    steps = np.linspace(0.0, end, _POINTS)
    values = []
    for one in metrics:
        known = np.isfinite(one["train/success"])
        # A short run may end before its first training episode does.
        at, seen = (
            one[key][known] if known.any() else [np.nan] for key in ("steps", "train/success")
        )
        values.append(np.interp(steps, at, seen, left=np.nan))
    return _curve(steps, np.array(values))


def evaluation_curve(metrics: Sequence[Mapping[str, Array]]) -> Curve:
    """Return how the evaluations along the way went: the first of all runs, the second and on."""
    judged = [np.isfinite(one["evaluation/success"]) for one in metrics]
    count = min(int(rows.sum()) for rows in judged)
    steps, values = (
        np.array([one[key][rows][:count] for one, rows in zip(metrics, judged, strict=True)])
        for key in ("steps", "evaluation/success")
    )
    return _curve(steps.mean(axis=0), values)


def curves_figure(runs: Sequence[Run], levels: Mapping[str, Mapping[str, float]]) -> Figure:
    """Return the picture of all runs' learning curves.

    Args:
        runs: At least one.
        levels: For each robot shares in 0-1 to compare with, by name.
    """
    robots = list(dict.fromkeys(run.robot for run in runs))
    with rc_context(STYLE):
        figure = Figure(figsize=(0.6 + _PANEL_INCHES * len(robots), 4.3), layout="constrained")
        panels = figure.subplots(1, len(robots), squeeze=False, sharey=True)[0]
        for axes, robot in zip(panels, robots, strict=True):
            own = [run for run in runs if run.robot == robot]
            for algorithm in dict.fromkeys(run.algorithm for run in own):
                _draw(axes, algorithm, [run for run in own if run.algorithm == algorithm])
            _draw_levels(axes, levels.get(robot, {}))
            axes.set_title(f"{TITLES.get(robot, robot)}, {own[0].task}")
            axes.set_xlabel("environment steps (thousands)")
            axes.set_xlim(left=0.0)
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=9)
        panels[0].set_ylabel("episodes without a failure")
        panels[0].set_ylim(0.0, 1.02)
        panels[0].yaxis.set_major_formatter(PercentFormatter(1.0))
    return figure


def _curve(steps: Array, values: Array) -> Curve:
    deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(len(steps))
    return Curve(steps, values.mean(axis=0), deviation)


def _draw(axes: Axes, algorithm: str, runs: Sequence[Run]) -> None:
    metrics = [read_metrics(run.folder) for run in runs]
    colour, name = _COLOURS.get(algorithm, INK), algorithm.upper()
    seeds = f", mean and std of {len(runs)} seeds" if len(runs) > 1 else ", 1 seed"
    training, judged = training_curve(metrics), evaluation_curve(metrics)
    steps = training.steps / 1000.0
    low, high = training.mean - training.deviation, training.mean + training.deviation
    axes.fill_between(steps, low.clip(0.0), high.clip(max=1.0), color=colour, alpha=0.2, lw=0.0)
    axes.plot(steps, training.mean, color=colour, lw=1.8, label=f"{name} training{seeds}")
    axes.errorbar(
        judged.steps / 1000.0, judged.mean, yerr=judged.deviation if len(runs) > 1 else None,
        fmt="o", color=colour, ms=6.5, mec="white", capsize=3, elinewidth=1.4, zorder=4,
        label=f"{name} evaluation, without noise",
    )  # fmt: skip


def _draw_levels(axes: Axes, levels: Mapping[str, float]) -> None:
    """Draw lines to compare with, their names beside the axes and apart from each other."""
    ordered = sorted(levels.items(), key=lambda item: item[1])
    places = apart([value for _, value in ordered], 0.05)
    for (name, value), y in zip(ordered, places, strict=True):
        axes.axhline(value, color=FAINT, lw=1.1, ls=(0, (5, 3)), zorder=1.5)
        axes.annotate(
            f"{name} {value:.1%}", (1.015, y), xycoords=("axes fraction", "data"), fontsize=8.5,
            va="center", color=INK, annotation_clip=False,
        )  # fmt: skip
