"""2-D plots: motions of a generator, sweeps, and fits of a base's response."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.figure import Figure

from kinfeas.core.spatial import Array
from kinfeas.testing.rules import Samples, Trial
from kinfeas.viz.style import BASE, EE, FAILURE, FAINT, GOAL, STYLE

if TYPE_CHECKING:  # takes long to import
    from kinfeas.sim2real.identify.fit import ResponseFit

_STILL = 1e-3  # fraction of the largest speed, below which nothing moves visibly
_AXES = ("x (m/s)", "y (m/s)", "rotation (rad/s)")
_SMOOTHED = 5  # measurements in a mean: single ones are noisy


def motion_figure(name: str, samples: Samples, trial: Trial) -> Figure:
    """Return plots of sample motions: paths from above and from the side, and speeds."""
    colours = colormaps["viridis"](np.linspace(0.0, 0.85, len(samples.goal)))
    linear, angular = np.linalg.norm(np.split(samples.twist, 2, axis=-1), axis=-1)
    time = trial.dt * np.arange(len(linear), dtype=np.float64)
    moving = np.zeros(len(time), dtype=bool)
    with rc_context(STYLE):
        figure = Figure(figsize=(11.0, 7.2), layout="constrained")
        above, aside, *below = figure.subplots(2, 2).ravel()
        for axes, other, title in ((above, 1, "from above"), (aside, 2, "from the side")):
            for path, goal, colour in zip(
                samples.ee_pose.swapaxes(0, 1), samples.goal, colours, strict=True
            ):
                axes.plot(path[:, 0], path[:, other], color=colour, lw=1.4)
                axes.plot(path[0, 0], path[0, other], "o", color=colour, ms=4)
                axes.plot(goal[0], goal[other], "D", color="none", mec=GOAL, mew=1.4, ms=7)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set(xlabel="x (m)", ylabel=f"{'xyz'[other]} (m)", title=title)
        for axes, speed, limit, label in (
            (below[0], linear, trial.max_velocity, "speed (m/s)"),
            (below[1], angular, trial.max_angular_velocity, "angular speed (rad/s)"),
        ):
            for curve, colour in zip(speed.T, colours, strict=True):
                axes.plot(time, curve, color=colour, lw=1.2)
            if limit is not None:
                axes.axhline(limit, color=FAILURE, lw=1.2, ls=(0, (4, 2)), label="limit")
                axes.legend(loc="upper right")
            axes.set_ylim(bottom=0.0)
            axes.set(xlabel="time (s)", ylabel=label)
            moving |= np.any(speed > _STILL * speed.max(initial=0.0), axis=1)
        for axes in below if moving.any() else ():
            axes.set_xlim(right=1.05 * max(time[moving][-1], trial.dt))
        title = f"{name}: {len(samples.goal)} sample motions, each to its goal (diamond)"
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    return figure


def search_figure(results: Sequence[Mapping[str, Any]], importances: Mapping[str, float]) -> Figure:
    """Return plots of a sweep: the scores of its trials, and the importance of each key."""
    finished = [trial for trial in results if "score" in trial]
    with rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.8), layout="constrained")
        history, bars = figure.subplots(1, 2, width_ratios=[1.4, 1.0])
        for state, colour in (("complete", EE), ("pruned", FAINT)):
            trials = [trial for trial in finished if trial["state"] == state]
            numbers = [trial["number"] for trial in trials]
            scores = [trial["score"] for trial in trials]
            history.plot(numbers, scores, "o", color=colour, ms=6.0, mec="white", label=state)
        complete = [trial for trial in finished if trial["state"] == "complete"]
        best = np.maximum.accumulate([trial["score"] for trial in complete])
        numbers = [trial["number"] for trial in complete]
        history.step(numbers, best, where="post", color=EE, lw=1.6, zorder=1.5, label="best")
        history.set(xlabel="trial", title="score")
        history.xaxis.get_major_locator().set_params(integer=True)
        history.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3)
        names = sorted(importances, key=lambda key: importances[key])
        bars.barh(names, [importances[name] for name in names], color=BASE)
        bars.grid(axis="y", visible=False)
        bars.set(title="importance", xlabel="share of the variance of the score")
    return figure


def velocities_figure(fit: "ResponseFit") -> Figure:
    """Return a plot of velocities in world axes over time, with one column for each record."""
    with rc_context(STYLE):
        columns = len(fit.times)
        figure = Figure(figsize=(max(11.0, 6.0 * columns), 6.4), layout="constrained")
        grid = figure.subplots(3, columns, sharex="col", sharey="row", squeeze=False)
        for column, time in enumerate(fit.times):
            for row, label in enumerate(_AXES):
                axes, measured = grid[row, column], fit.measured[column][:, row]
                axes.plot(time, measured, color=FAINT, lw=0.4, alpha=0.5, label="measured")
                axes.plot(time, _smooth(measured), color=BASE, lw=1.0, label="its mean of 5")
                axes.plot(
                    time, fit.predicted[column][:, row], color=FAILURE, lw=1.2, label="predicted"
                )
                if column == 0:
                    axes.set_ylabel(label)
                    axes.set_ylim(*_limits(fit, row))
            grid[-1, column].set_xlabel("time (s)")
        grid[0, 0].legend(loc="upper right", ncols=3, fontsize=8.0)
    return figure


def _smooth(values: Array) -> Array:
    return np.convolve(values, np.ones(_SMOOTHED) / _SMOOTHED, mode="same")


def _limits(fit: "ResponseFit", row: int) -> tuple[float, float]:
    """Return limits of an axis, which rare jumps of the localisation may exceed."""
    most = [np.quantile(np.abs(_smooth(values[:, row])), 0.97) for values in fit.measured]
    most += [np.abs(values[:, row]).max() for values in fit.predicted]
    limit = 1.5 * max(0.02, *map(float, most))
    return -limit, limit
