"""The table of a benchmark as a picture: a panel for each robot and task."""

from collections.abc import Sequence
from textwrap import fill

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from kinfeas.benchmark.physics import PhysicsCell
from kinfeas.benchmark.table import Cell
from kinfeas.benchmark.text import groups, label, title
from kinfeas.viz.style import BASE, EE, GOAL, INK, STYLE

_BEYOND = "#e4e7eb"
_ROW_INCHES, _PANEL_INCHES = 0.27, 2.35
_LEGEND_INCHES = (7.4, 9.0)

Row = tuple[str, str]


def table_figure(cells: Sequence[Cell], note: str = "") -> Figure:
    """Return the picture of success: ours with its interval, the paper's, and the ceiling.

    Args:
        cells: What was found.
        note: A sentence above it; may be empty.
    """
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    names = groups(cells)
    policies = [_policies(cells, group) for group in names]
    heights = [_ROW_INCHES * (len(rows) + 1.0) for rows in policies]
    with rc_context(STYLE):
        physical = any(isinstance(cell, PhysicsCell) for cell in cells)
        width = max(_LEGEND_INCHES[physical], 1.9 + _PANEL_INCHES * len(tasks))
        height = 1.1 + sum(heights) + 0.3 * len(names)
        figure = Figure(figsize=(width, height), layout="constrained")
        panels = figure.subplots(len(names), len(tasks), squeeze=False, height_ratios=heights)
        for row, (group, rows) in enumerate(zip(names, policies, strict=True)):
            for column, task in enumerate(tasks):
                own = {
                    cell.row: cell for cell in cells if (*cell.group, cell.task) == (*group, task)
                }
                _draw_panel(panels[row, column], own, rows, first=column == 0)
            panels[row, 0].set_title(title(*group))
        for column, task in enumerate(tasks):
            panels[0, column].set_title(task, loc="center", fontweight="normal")
            _label_lowest(list(panels[:, column]))
        figure.legend(
            handles=_legend(physical=physical), loc="outside lower center", ncols=6, fontsize=9.5
        )
        if note:
            figure.suptitle(fill(note, int(13 * width)), fontsize=9.5, x=0.01, ha="left")
    return figure


def _policies(cells: Sequence[Cell], group: tuple[str, str]) -> dict[Row, str]:
    """Return the rows of a robot, in order, with what they are called."""
    own = [cell for cell in cells if cell.group == group]
    return {cell.row: label(cell) for cell in own}


def _draw_panel(axes: Axes, own: dict[Row, Cell], rows: dict[Row, str], first: bool) -> None:
    axes.set_xlim(0.0, 100.0)
    axes.set_ylim(len(rows) - 0.45, -0.55)
    axes.set_yticks(range(len(rows)), list(rows.values()) if first else [""] * len(rows))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.spines["left"].set_visible(False)
    if not own:
        # The names of the rows stay.
        axes.xaxis.set_visible(False)
        axes.spines["bottom"].set_visible(False)
        return
    ceiling = 100.0 * next(iter(own.values())).ceiling
    axes.axvspan(ceiling, 100.0, color=_BEYOND, lw=0.0, zorder=0.5)
    axes.axvline(ceiling, color=INK, lw=1.2, ls=(0, (4, 2)), zorder=2)
    for place, policy in enumerate(rows):
        if policy in own:
            _draw_row(axes, place, own[policy])


def _draw_row(axes: Axes, place: int, cell: Cell) -> None:
    value, colour = 100.0 * cell.success, EE if cell.learned else BASE
    axes.plot(
        [100.0 * cell.success_low, 100.0 * cell.success_high], [place, place],
        color=colour, lw=4.5, alpha=0.35, solid_capstyle="butt", zorder=3,
    )  # fmt: skip
    axes.plot([value], [place], "o", color=colour, ms=6.5, mec="white", mew=0.8, zorder=5,
              clip_on=False)  # fmt: skip
    if isinstance(cell, PhysicsCell):
        axes.plot([100.0 * cell.analytic_success], [place], "|", color=colour, mew=2.2, ms=11,
                  zorder=4.5, clip_on=False)  # fmt: skip
    if cell.paper_success is not None:
        axes.plot([100.0 * cell.paper_success], [place], "D", color="none", mec=GOAL, mew=1.7,
                  ms=6.5, zorder=4, clip_on=False)  # fmt: skip
    axes.annotate(
        f"{value:.1f}", (1.0, place), xytext=(9, 0), xycoords=("axes fraction", "data"),
        textcoords="offset points", va="center", fontsize=8.5, color=colour,
        fontweight="bold" if cell.learned else "normal", annotation_clip=False,
    )  # fmt: skip


def _label_lowest(panels: Sequence[Axes]) -> None:
    """Write the axis below the lowest panel of a column that shows anything."""
    shown = [axes for axes in panels if axes.xaxis.get_visible()]
    for axes in shown[:-1]:
        axes.tick_params(axis="x", labelbottom=False)
    shown[-1].set_xlabel("% of episodes without a failure", fontsize=9)


def _legend(*, physical: bool) -> list[Line2D]:
    handles = [
        Line2D([], [], color=EE, lw=0, marker="o", ms=7, label="learned"),
        Line2D([], [], color=BASE, lw=0, marker="o", ms=7, label="baseline"),
        Line2D([], [], color=BASE, lw=4.5, alpha=0.35, label="95 % interval"),
        Line2D([], [], color="none", lw=0, marker="D", mec=GOAL, mew=1.7, ms=7, label="paper"),
        Line2D([], [], color=INK, lw=1.2, ls=(0, (4, 2)),
               label="ceiling"),
    ]  # fmt: skip
    if physical:
        handles.append(
            Line2D([], [], color=INK, lw=0, marker="|", mew=2.2, ms=11, label="without physics")
        )
    return handles
