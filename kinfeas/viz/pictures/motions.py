"""Sample motions of a motion generator: their paths from above and aside, and their speeds."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kinfeas.core.spatial import Array
from kinfeas.testing.trial import Samples, Trial
from kinfeas.viz.pictures.style import FAILURE, FAINT, GOAL, INK, STYLE

_WIDTH, _HEIGHT = 11.0, 7.2
_COLOURS = colormaps["viridis"]
_STILL = 1e-3  # of the largest speed, which is no more than the width of a line
_AFTER = 1.05  # end of the time axis, as a multiple of the time at which the last motion ends


def motion_figure(name: str, samples: Samples, trial: Trial) -> Figure:
    """Return the picture of a trial's motions.

    Args:
        name: What to call the motion generator.
        samples: Its motions.
        trial: What it was put to; its limits are drawn.
    """
    colours = _COLOURS(np.linspace(0.0, 0.85, len(samples.goal)))
    with rc_context(STYLE):
        figure = Figure(figsize=(_WIDTH, _HEIGHT), layout="constrained")
        above, aside, speed, turning = figure.subplots(2, 2).ravel()
        _draw_paths(above, samples, colours, (0, 1), ("x (m)", "y (m)"))
        above.set_title("from above")
        _draw_paths(aside, samples, colours, (0, 2), ("x (m)", "z (m)"))
        aside.set_title("from the side")
        time = trial.dt * np.arange(len(samples.twist), dtype=np.float64)
        moving = _moving(samples.twist)
        _draw_speeds(speed, time, samples.twist[..., :3], colours, trial.max_velocity)
        speed.set_ylabel("speed (m/s)")
        _draw_speeds(turning, time, samples.twist[..., 3:], colours, trial.max_angular_velocity)
        turning.set_ylabel("angular speed (rad/s)")
        for axes in (speed, turning) if moving.any() else ():
            axes.set_xlim(right=_AFTER * max(time[moving][-1], trial.dt))
        figure.suptitle(_title(name, samples), fontsize=11, x=0.01, ha="left")
    return figure


def _moving(twist: Array) -> NDArray[np.bool_]:
    """Return whether it shows at each time that one of the motions goes on, shape (t,)."""
    speed = np.stack([np.linalg.norm(part, axis=-1) for part in np.split(twist, 2, axis=-1)])
    shows = speed > _STILL * speed.max(axis=(1, 2), initial=0.0, keepdims=True)
    moving: NDArray[np.bool_] = shows.any(axis=(0, 2))
    return moving


def _title(name: str, samples: Samples) -> str:
    text = f"{name}: {len(samples.goal)} sample motions, each to its goal (diamond)"
    return text if samples.broken is None else fill(f"{text}; it ends early: {samples.broken}", 120)


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
