"""2-D plots: learning curves, motions of a generator, success within adapters."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.evaluation.sim2real import ALL, NONE, Cost, Sweep
from kinfeas.testing.trial import Samples, Trial
from kinfeas.viz.style import BASE, EE, FAILURE, FAINT, GOAL, INK, STYLE

_PLOTTED = ("steps", "seconds", "train/success", "evaluation/success")
_COLOURS = colormaps["viridis"]
_STILL = 1e-3  # of the largest speed: too small to be seen


def read_metrics(run: Path) -> dict[str, Array]:
    """Return columns of a run's `metrics.csv` by name, NaN where a row has no entry.

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
    """Return a plot of success over time and steps.

    Args:
        metrics: Columns of `metrics.csv`.
        levels: Other success rates, 0-1, by name, drawn as horizontal lines.
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
    """Return ascending `values`, moved up where the distance is below `gap`."""
    placed: list[float] = []
    for value in values:
        placed.append(max(value, placed[-1] + gap) if placed else value)
    return placed


def _draw_levels(axes: Axes, levels: Mapping[str, float]) -> None:
    ordered = sorted(levels.items(), key=lambda item: item[1])
    for (name, value), y in zip(ordered, apart([v for _, v in ordered], 0.055), strict=True):
        axes.axhline(value, color=FAINT, lw=1.1, ls=(0, (5, 3)), zorder=1.5)
        axes.annotate(
            f"{name} {value:.1%}", (1.0, value), xytext=(1.015, y), va="center", fontsize=9,
            xycoords=("axes fraction", "data"), textcoords=("axes fraction", "data"), color=INK,
            annotation_clip=False,
        )  # fmt: skip


def _add_steps(axes: Axes, minutes: Array, steps: Array) -> None:
    above = axes.secondary_xaxis("top")
    above.xaxis.set_major_formatter(
        FuncFormatter(lambda x, _: f"{np.interp(x, minutes, steps, left=0.0) / 1000.0:,.0f} k")
    )
    above.set_xlabel("environment steps")


def motion_figure(name: str, samples: Samples, trial: Trial) -> Figure:
    """Return plots of sample motions: paths from above and from the side, and speeds.

    Args:
        name: Of the motion generator.
        samples: Its motions.
        trial: Gives the control period and the velocity limits.
    """
    colours = _COLOURS(np.linspace(0.0, 0.85, len(samples.goal)))
    with rc_context(STYLE):
        figure = Figure(figsize=(11.0, 7.2), layout="constrained")
        above, aside, speed, turning = figure.subplots(2, 2).ravel()
        _draw_paths(above, samples, colours, (0, 1), ("x (m)", "y (m)"))
        above.set_title("from above")
        _draw_paths(aside, samples, colours, (0, 2), ("x (m)", "z (m)"))
        aside.set_title("from the side")
        time = trial.dt * np.arange(len(samples.twist), dtype=np.float64)
        norms = np.linalg.norm(samples.twist.reshape(*samples.twist.shape[:2], 2, 3), axis=-1)
        largest = norms.max(axis=(0, 1), initial=0.0)
        moving = (norms > _STILL * largest).any(axis=(1, 2))
        _draw_speeds(speed, time, samples.twist[..., :3], colours, trial.max_velocity)
        speed.set_ylabel("speed (m/s)")
        _draw_speeds(turning, time, samples.twist[..., 3:], colours, trial.max_angular_velocity)
        turning.set_ylabel("angular speed (rad/s)")
        for axes in (speed, turning) if moving.any() else ():
            axes.set_xlim(right=1.05 * max(time[moving][-1], trial.dt))
        title = f"{name}: {len(samples.goal)} sample motions, each to its goal (diamond)"
        if samples.broken is not None:
            title = fill(f"{title}; it ends early: {samples.broken}", 120)
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    return figure


def _draw_paths(
    axes: Axes, samples: Samples, colours: Array, shown: tuple[int, int], labels: Sequence[str]
) -> None:
    first, second = shown
    for row, colour in enumerate(colours):
        path = samples.ee_pose[:, row]
        axes.plot(path[:, first], path[:, second], color=colour, lw=1.4)
        axes.plot(*path[0, list(shown)], "o", color=colour, ms=4)
        axes.plot(*samples.goal[row, list(shown)], "D", color="none", mec=GOAL, mew=1.4, ms=7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])


def _draw_speeds(
    axes: Axes, time: Array, velocity: Array, colours: Array, limit: float | None
) -> None:
    speed = np.linalg.norm(velocity, axis=-1)
    for row, colour in enumerate(colours):
        axes.plot(time, speed[:, row], color=colour, lw=1.2)
    if limit is not None:
        axes.axhline(limit, color=FAILURE, lw=1.2, ls=(0, (4, 2)))
        axes.annotate(
            "limit", (1.0, limit), xycoords=("axes fraction", "data"), xytext=(-2, 3),
            textcoords="offset points", ha="right", color=FAILURE, fontsize=9,
        )  # fmt: skip
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time (s)", color=INK)
    axes.tick_params(color=FAINT)


def sim2real_figure(title: str, costs: Sequence[Cost], sweeps: Sequence[Sweep]) -> Figure:
    """Return plots of success: each adapter alone and each left out, and over parameters.

    Args:
        title: Line above the plots.
        costs: Rows of the first panel, with 95 % intervals.
        sweeps: One panel each.
    """
    with rc_context(STYLE):
        width = 4.6 + 2.7 * len(sweeps)
        height = max(3.4, 1.3 + 0.24 * len(costs))
        figure = Figure(figsize=(width, height), layout="constrained")
        ratios = [1.3, *(1.0 for _ in sweeps)]
        panels = figure.subplots(1, 1 + len(sweeps), squeeze=False, width_ratios=ratios)[0]
        _draw_costs(panels[0], costs)
        for axes, sweep in zip(panels[1:], sweeps, strict=True):
            _draw_sweep(axes, sweep)
            axes.set_ylabel("")
            axes.sharey(panels[1])
        if sweeps:
            panels[1].set_ylabel("episodes without a failure")
        figure.suptitle(title, fontsize=10.5, x=0.01, ha="left")
    return figure


def _draw_costs(axes: Axes, costs: Sequence[Cost]) -> None:
    for place, cost in enumerate(costs):
        share = cost.figures["success"]
        low, high = cost.figures["success_low"], cost.figures["success_high"]
        colour = EE if cost.adapter in (NONE, ALL) else BASE
        axes.plot([low, high], [place, place], color=colour, lw=4.5, alpha=0.3,
                  solid_capstyle="butt")  # fmt: skip
        axes.plot([share], [place], "o", color=colour, ms=6.0, mec="white", mew=0.8)
    for end in (costs[0], costs[-1]):
        axes.axvline(end.figures["success"], color=FAINT, lw=1.1, ls=(0, (5, 3)), zorder=1.5)
    axes.set_yticks(range(len(costs)), [cost.label for cost in costs])
    axes.set_ylim(len(costs) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_xlabel("each adapter alone, each left out, and all")


def _draw_sweep(axes: Axes, sweep: Sweep) -> None:
    values = sweep.axis.values
    shares = [figures["success"] for figures in sweep.figures]
    lows = [figures["success_low"] for figures in sweep.figures]
    highs = [figures["success_high"] for figures in sweep.figures]
    axes.fill_between(values, lows, highs, color=EE, alpha=0.18, lw=0.0)
    axes.plot(values, shares, "o-", color=EE, lw=2.0, ms=6.0, mec="white", clip_on=False)
    axes.set_xlabel(sweep.axis.title, color=INK)
    axes.set_ylim(0.0, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
