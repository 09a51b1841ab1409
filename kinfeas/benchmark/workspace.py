"""The EE workspace that episodes cover, relative to the base, from above and from the side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from kinfeas.benchmark.samples import thinned
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.evaluation.paper import TITLES
from kinfeas.robots.robot import Robot
from kinfeas.viz.drawing import corners, robot_solids
from kinfeas.viz.style import BODY, EE, FAILURE, STYLE

_MARGIN = 0.15
_MOST = 3000
"""Points of a kind that are drawn; more hide each other."""

_VIEWS = (([0, 1], "y (m)"), ([0, 2], "z (m)"))


@dataclass(frozen=True, eq=False)
class Covered:
    """Where the EE was asked to be in one robot's episodes.

    Attributes:
        robot: Whose.
        feasible: Points in the base frame where IK found it, shape (k, 3), metres.
        infeasible: Points where it did not, shape (m, 3), metres.
        failed: Share of all steps that were infeasible, 0-1.
    """

    robot: Robot
    feasible: Array
    infeasible: Array
    failed: float


def covered(robot: Robot, results: Sequence[Mapping[str, Mapping[str, object]]]) -> Covered:
    """Return what the results of a robot's learned policies say together.

    Args:
        robot: Whose they are.
        results: As `cells.compute` returns them, at least one.
    """
    points = {
        kind: np.concatenate(
            [np.reshape(np.array(result["workspace"][kind], dtype=float), (-1, 3))
             for result in results]
        )
        for kind in ("feasible", "infeasible")
    }  # fmt: skip
    failures, steps = (
        sum(float(result["figures"][key]) * int(result["figures"]["episodes"])  # type: ignore[arg-type,call-overload]
            for result in results)
        for key in ("ik_failures_per_episode", "mean_steps")
    )  # fmt: skip
    return Covered(
        robot, thinned(points["feasible"], _MOST), thinned(points["infeasible"], _MOST),
        failures / steps,
    )  # fmt: skip


def workspace_figure(robots: Sequence[Covered]) -> Figure:
    """Return the picture: a column for each robot, seen from above and from the side."""
    with rc_context(STYLE):
        width = max(0.4 + 4.3 * len(robots), 5.4)  # what the legend needs
        figure = Figure(figsize=(width, 8.3), layout="constrained")
        panels = figure.subplots(2, len(robots), squeeze=False)
        for column, one in zip(panels.T, robots, strict=True):
            for axes, (shown, across) in zip(column, _VIEWS, strict=True):
                _draw(axes, one, shown)
                axes.set(xlabel="x, ahead of the base (m)", ylabel=across)
            name = TITLES.get(one.robot.name, one.robot.name)
            column[0].set_title(f"{name}: {one.failed:.2%} of all steps infeasible")
        columns = 3 if len(robots) > 2 else 1
        figure.legend(handles=_legend(), loc="outside lower center", ncols=columns)
    return figure


def _draw(axes: Axes, one: Covered, shown: list[int]) -> None:
    solids = robot_solids(one.robot, IDENTITY, one.robot.home["home"])
    body = [corners([solid])[:, shown] for solid in solids if solid.colour == BODY]
    for points in body:
        outline = points[ConvexHull(points).vertices]
        axes.add_patch(Polygon(outline, facecolor=BODY, edgecolor="#9aa2ad", lw=0.4, zorder=3))
    feasible, infeasible = one.feasible[:, shown], one.infeasible[:, shown]
    axes.plot(*feasible.T, "o", color=EE, ms=2.0, mew=0.0, alpha=0.35, zorder=5)
    axes.plot(*infeasible.T, "o", color=FAILURE, ms=2.6, mew=0.0, alpha=0.7, zorder=6)
    seen = np.concatenate([feasible, *body])
    # What was lost far from the base would make all else small.
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = float(np.max(high - low)) / 2.0 + _MARGIN
    (left, bottom), (right, top) = (low + high) / 2.0 - half, (low + high) / 2.0 + half
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], color=EE, lw=0, marker="o", ms=6, label="EE, some of the feasible steps"),
        Line2D([], [], color=FAILURE, lw=0, marker="o", ms=6,
               label="where it should have been, infeasible steps; some lie outside"),
        Line2D([], [], color=BODY, lw=0, marker="s", ms=9, label="the robot without its arm"),
    ]  # fmt: skip
