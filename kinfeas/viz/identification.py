"""A picture of measured velocities of a base against those of its fitted response."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from kinfeas.core.spatial import Array
from kinfeas.sim2real.identify.fit import Fit
from kinfeas.viz.style import BASE, FAILURE, FAINT, STYLE

_AXES = ("x (m/s)", "y (m/s)", "rotation (rad/s)")
_SMOOTHED = 5  # measurements in a mean: single ones are noisy


def velocities_figure(fit: Fit) -> Figure:
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
                axes.set_ylim(*_limits(_smooth(measured)))
                if column == 0:
                    axes.set_ylabel(label)
            grid[-1, column].set_xlabel("time (s)")
        grid[0, 0].legend(loc="upper right", ncols=3, fontsize=8.0)
    return figure


def _smooth(values: Array) -> Array:
    return np.convolve(values, np.ones(_SMOOTHED) / _SMOOTHED, mode="same")


def _limits(values: Array) -> tuple[float, float]:
    most = 1.2 * max(0.02, float(np.quantile(np.abs(values), 0.998)))
    return -most, most
