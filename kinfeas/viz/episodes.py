"""Pictures of recorded episodes, and of base poses that reach a pose, drawn by matplotlib."""

from collections.abc import Iterator, Sequence
from itertools import chain
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from kinfeas.core import spatial
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.planning.reach import Placement
from kinfeas.robots.robot import Robot
from kinfeas.viz import drawing, shapes
from kinfeas.viz.replay import Recording, caption, side_heading
from kinfeas.viz.shapes import VisualShape
from kinfeas.viz.style import ARM, BASE, BODY, DESIRED, EE, FAILURE, GOAL, INK, STYLE

_ELEVATION = np.deg2rad(28.0)
_PALEST = 0.62  # fraction of white in the robot at the start
_NEAR = 1.0  # m, margin around the paths within which furniture is drawn
_AROUND = 0.7  # m, the same for solids in the side view
_FURNITURE = (0.86, 0.79, 0.69, 0.6)
_APPROACH = 0.2  # m, length of the line that shows the x axis of the EE
_CASING = [patheffects.withStroke(linewidth=3.4, foreground="white", alpha=0.85)]


def episodes_figure(
    robot: Robot, recordings: Sequence[Recording], titles: Sequence[str] | None = None
) -> Figure:
    """Return a picture with a column for each episode: from the side, and from above."""
    count = len(recordings)
    titles = titles or [
        f"Episode {recording.episode}: {caption(recording)}" for recording in recordings
    ]
    with rc_context(STYLE):
        figure = Figure(figsize=(5.0 * count, 7.8), layout="constrained")
        grid = figure.add_gridspec(2, count, height_ratios=(0.7, 1.0))
        for column, (recording, title) in enumerate(zip(recordings, titles, strict=True)):
            furniture, heading = _furniture_near(recording), side_heading(recording)
            side = drawing.add_axes(figure, grid[0, column], heading, _ELEVATION)
            _draw_side(side, robot, recording, [*chain.from_iterable(furniture)])
            side.set_title(fill(title, 50))
            top = figure.add_subplot(grid[1, column])
            for solids in furniture:
                draw_outline(top, shapes.corners(solids), _FURNITURE, 1.8)
            _draw_top(top, robot, recording)
        columns = {1: 3, 2: 4}.get(count, 7)
        failed = any(not recording.feasible.all() for recording in recordings)
        handles: list[Artist] = [*_legend(failed=failed)]
        near = [_solids_near(episode, moment) for episode in recordings for moment in (0, -1)]
        drawn = {BODY, *(solid.colour for solid in chain.from_iterable(near))}
        named = {BODY: "robot", shapes.LOW: "solid", shapes.HIGH: "wall"}
        handles += [Patch(color=key[:7], label=text) for key, text in named.items() if key in drawn]
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=10)
    return figure


def reach_figure(
    robot: Robot, goal: Array, best: Placement, placement: Placement, solids: Solids | None
) -> Figure:
    """Return a top view of base poses that reach an EE pose, coloured by their margins.

    Args:
        robot: Robot, drawn at the first base pose of `best`.
        goal: World EE pose, shape (7,).
        best: Best base poses.
        placement: All base poses to draw.
        solids: Solids, one row.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(7.0, 6.0), layout="constrained")
        axes = figure.add_subplot()
        for solid in shapes.solid_shapes(solids):
            draw_outline(axes, shapes.corners([solid]), (*to_rgb(solid.colour[:7]), 0.75), 1.8)
        if best.reachable and placement.reachable:
            for solid in shapes.robot_solids(robot, best.base_pose[0], best.joint_positions[0]):
                draw_outline(axes, shapes.corners([solid]), (*to_rgb(BODY), 0.4), 2.0)
            base, heading = placement.base_pose[::-1], spatial.yaw(placement.base_pose[::-1])
            arrows = axes.quiver(
                base[:, 0], base[:, 1], np.cos(heading), np.sin(heading), placement.margin[::-1],
                angles="xy", units="inches", scale_units="inches", scale=5.0, width=0.022,
                cmap="viridis", zorder=4,
            )  # fmt: skip
            figure.colorbar(arrows, label="margin of the base pose", shrink=0.8)
        approach = _APPROACH * spatial.rotation(goal).as_matrix()[:2, 0]
        axes.plot(*np.stack([goal[:2], goal[:2] + approach]).T, color=GOAL, lw=3.0, zorder=6)
        axes.plot(*goal[:2], "*", color=GOAL, mec=INK, mew=0.7, ms=16.0, zorder=7)
        middle, half = goal[:2], 1.6
        axes.set(xlim=(middle[0] - half, middle[0] + half), xlabel="x (m)", ylabel="y (m)")
        axes.set(ylim=(middle[1] - half, middle[1] + half), aspect="equal")
        count = len(placement.base_pose)
        text = f"{count} base poses reach" if placement.reachable else "none for"
        axes.set_title(f"{robot.name}: {text} the EE pose at a height of {goal[2]:.2f} m")
    return figure


def moments(recording: Recording, spacing: float = 1.0, most: int = 4) -> NDArray[np.intp]:
    """Return indices of up to `most` moments, `spacing` m of base path apart, with both ends."""
    base = recording.base_pose[:, :2]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(base, axis=0), axis=1))])
    count = int(np.clip(1 + round(travelled[-1] / spacing), 2, most))
    indices = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count))
    return np.unique(np.append(indices[:-1], len(travelled) - 1))


def _furniture_near(recording: Recording) -> list[list[VisualShape]]:
    scene = recording.scene
    if scene is None:
        return []
    paths = np.concatenate([recording.base_pose[:, :2], recording.ee_pose[:, :2]])
    low, high = paths.min(axis=0) - _NEAR, paths.max(axis=0) + _NEAR
    around = shapes.surrounding(scene)
    near: dict[str, list[VisualShape]] = {
        name: []
        for name, entry in scene.objects.items()
        if np.all((entry.pose[:2] > low) & (entry.pose[:2] < high)) and name not in around
    }
    for solid in shapes.scene_solids(scene):
        if solid.link[0] in near:
            near[solid.link[0]].append(solid)
    return list(near.values())


def _solids_near(recording: Recording, moment: int, within: float = _NEAR) -> list[VisualShape]:
    points = [recording.base_pose, recording.desired, recording.goals]
    paths = np.concatenate([poses[:, :2] for poses in points])
    low, high = paths.min(axis=0) - within, paths.max(axis=0) + within
    return [
        solid
        for solid in shapes.solid_shapes(recording.solids_at(moment))
        if np.all(
            np.abs(solid.shape.pose[:2] - (low + high) / 2.0)
            < (high - low) / 2.0 + np.ptp(shapes.corners([solid])[:, :2], axis=0) / 2.0
        )
    ]


def _draw_side(
    axes: Axes3D, robot: Robot, recording: Recording, furniture: Sequence[VisualShape]
) -> None:
    solids = [*furniture, *_solids_near(recording, -1, _AROUND)]
    for *_, robot_solids in _fading(robot, recording):
        solids += robot_solids
    ends = recording.desired[:, :3], recording.goals[:, :3]
    points = np.concatenate([shapes.corners(solids), *ends])
    floor = drawing.draw_floor(axes, points)
    drawing.draw_solids(axes, solids)
    _draw_paths(axes, recording)
    drawing.show_all(axes, np.concatenate([points, floor]), 1.5)


def _draw_top(axes: Axes, robot: Robot, recording: Recording) -> None:
    for moment, opacity in ((0, 0.2), (-1, 0.75)):  # start (pale) and end
        for solid in _solids_near(recording, moment):
            colour = (*to_rgb(solid.colour[:7]), opacity)
            draw_outline(axes, shapes.corners([solid]), colour, 1.8)
    for moment, (body, arm), solids in _fading(robot, recording):
        carried = [solid for solid in solids if solid.colour == body]
        if carried:
            draw_outline(axes, shapes.corners(carried), (*to_rgb(body), 0.55), 2.0)
        reach = np.stack([recording.base_pose[moment, :2], recording.ee_pose[moment, :2]])
        axes.plot(*reach.T, color=arm, lw=3.0, zorder=5)
    _draw_paths(axes, recording)
    pose = recording.base_pose[moments(recording, 0.3, 12)]
    heading = spatial.yaw(pose)
    axes.quiver(
        pose[:, 0], pose[:, 1], np.cos(heading), np.sin(heading), color=BASE, zorder=6,
        angles="xy", units="inches", scale_units="inches", scale=4.2, width=0.026, pivot="tail",
    )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set(xlabel="x (m)", ylabel="y (m)")


def draw_outline(axes: Axes, points: Array, colour: tuple[float, ...], order: float) -> None:
    """Draw the convex outline of points (k, 3) as seen from above; `order` is the zorder."""
    outline = points[ConvexHull(points[:, :2]).vertices, :2]
    axes.add_patch(Polygon(outline, facecolor=colour, edgecolor="#9aa2ad", lw=0.9, zorder=order))


def _draw_paths(axes: Axes, recording: Recording) -> None:
    size = 3 if isinstance(axes, Axes3D) else 2

    def draw(points: Array, *marker: str, **how: Any) -> None:
        if len(points):  # mplot3d cannot draw nothing
            axes.plot(*points[:, :size].T, *marker, **how)

    base, ee = recording.base_pose, recording.ee_pose
    draw(base, color=BASE, lw=2.2, zorder=2.8)
    draw(ee, color=EE, lw=2.4, zorder=7, path_effects=_CASING)
    draw(recording.desired, color=DESIRED, lw=1.2, ls=(0, (4, 3)), zorder=8)
    draw(ee[~recording.feasible], "o", color=FAILURE, ms=5.0, mew=0.0, zorder=12)
    draw(ee[:1], "o", color="white", mec=EE, mew=2.0, ms=8.0, zorder=10)
    draw(base[:1], "o", color="white", mec=BASE, mew=2.0, ms=8.0, zorder=6.5)
    for goal in recording.goals:
        draw(np.stack([goal, goal * [1, 1, 0, 1, 1, 1, 1]]), color=GOAL, lw=1.3, ls=":", zorder=6)
    draw(recording.goals, "*", color=GOAL, mec=INK, mew=0.7, ms=16.0, zorder=11)


def _fading(
    robot: Robot, recording: Recording
) -> Iterator[tuple[int, tuple[str, str], list[VisualShape]]]:
    """Yield index, colours of body and arm (pale at first), and solids of each drawn moment."""
    drawn = moments(recording)
    for paleness, moment in zip(np.linspace(_PALEST, 0.0, len(drawn)), drawn.tolist(), strict=True):
        body, arm = (
            to_hex(tuple((1.0 - paleness) * np.array(to_rgb(colour)) + paleness))
            for colour in (BODY, ARM)
        )
        pose, joints = recording.base_pose[moment], recording.joint_positions[moment]
        yield moment, (body, arm), shapes.robot_solids(robot, pose, joints, (body, arm))


def _legend(*, failed: bool) -> list[Line2D]:
    point: dict[str, Any] = {"lw": 0, "marker": "o"}
    looks: dict[str, dict[str, Any]] = {
        "base path and heading": {"color": BASE, "lw": 2.2, "marker": ">", "ms": 7},
        "arm, base to EE": {"color": ARM, "lw": 3.0},
        "EE desired": {"color": DESIRED, "lw": 1.2, "ls": (0, (4, 3))},
        "EE achieved": {"color": EE, "lw": 2.4},
        "no IK solution": {**point, "color": FAILURE, "ms": 6},
        "start": {**point, "color": "white", "mec": DESIRED, "mew": 2.0, "ms": 8},
        "goal": {"color": GOAL, "lw": 0, "marker": "*", "mec": INK, "mew": 0.7, "ms": 15},
    }
    if not failed:
        del looks["no IK solution"]
    return [Line2D([], [], label=label, **look) for label, look in looks.items()]
