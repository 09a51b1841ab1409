"""Success against what stands between a policy and a robot, as a picture."""

from collections.abc import Sequence

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from kinfeas.evaluation.sim2real import ALL, NONE, Cost, Sweep
from kinfeas.viz.pictures.style import BASE, EE, FAINT, INK, STYLE


def sim2real_figure(title: str, costs: Sequence[Cost], sweeps: Sequence[Sweep]) -> Figure:
    """Return the picture: on the left each adapter alone and left out, then success along axes.

    Args:
        title: A line above it.
        costs: Bars, with their 95 % intervals.
        sweeps: A panel each.
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
