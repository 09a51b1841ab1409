"""Episodes at a glance: the robot at a few moments, and all paths from above."""

from collections.abc import Sequence

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.evaluation.recording import Recording
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.viz.pictures.projection import (
    Painted,
    View,
    draw_floor,
    draw_solids,
    look,
    show_to_scale,
)
from kinfeas.viz.pictures.raster import paint_solids
from kinfeas.viz.pictures.scene import scene_faces, surrounds
from kinfeas.viz.pictures.solids import robot_faces
from kinfeas.viz.pictures.style import (
    ARM,
    BASE,
    BODY,
    DESIRED,
    EE,
    FAILURE,
    GOAL,
    INK,
    STYLE,
    failures_text,
)

_ELEVATION, _TURN = np.deg2rad(28.0), np.deg2rad(12.0)
_PALEST = 0.62
_ARROW_METRES = 0.3
_NEAR = 1.0  # m, of furniture from the paths' bounds
_FURNITURE = (0.86, 0.79, 0.69, 0.6), 1.8
_CASING = [patheffects.withStroke(linewidth=3.4, foreground="white", alpha=0.85)]


def episodes_figure(
    robot: Robot,
    recordings: Sequence[Recording],
    titles: Sequence[str] | None = None,
    scene: Scene | None = None,
) -> Figure:
    """Return a picture with a column for each episode: seen from the side, and from above.

    Args:
        robot: Who moves.
        recordings: At least one.
        titles: Of the columns; by default, what each episode came to.
        scene: What stands around.
    """
    count = len(recordings)
    titles = titles or [_title(recording) for recording in recordings]
    with rc_context(STYLE):
        figure = Figure(figsize=(5.0 * count, 7.8), layout="constrained")
        rows = figure.subplots(2, count, squeeze=False, height_ratios=(0.7, 1.0))
        for recording, title, side, top in zip(recordings, titles, *rows, strict=True):
            furniture = [] if scene is None else _near(scene, recording)
            _draw_side(side, robot, recording, furniture)
            for thing in furniture:
                _draw_outline(top, np.concatenate([face.corners for face in thing]), *_FURNITURE)
            _draw_top(top, robot, recording)
            side.set_title(title)
        columns = {1: 3, 2: 4}.get(count, 7)
        figure.legend(handles=_legend(), loc="outside lower center", ncols=columns, fontsize=10)
    return figure


def _title(recording: Recording) -> str:
    failures = int(np.sum(~recording.feasible))
    end = "goal reached" if recording.reached else "goal missed"
    times = failures_text(failures)
    seconds = (len(recording.feasible) - 1) * recording.dt
    return f"Episode {recording.episode}: {end}, {times}, {seconds:.0f} s"


def moments(recording: Recording, spacing: float = 1.0, most: int = 4) -> NDArray[np.intp]:
    """Return the moments to draw the robot at: its start, its end, and some even way between.

    Args:
        recording: The episode.
        spacing: Metres of the base's path between two of them.
        most: How many at most.
    """
    base = recording.base_pose[:, :2]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(base, axis=0), axis=1))])
    count = int(np.clip(1 + round(way[-1] / spacing), 2, most))
    return np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], count)).clip(0, len(way) - 1))


def _near(scene: Scene, recording: Recording) -> list[list[Painted]]:
    """Return the faces of each object that stands near the paths."""
    things: dict[str, list[Painted]] = {}
    for name, face in scene_faces(scene):
        things.setdefault(name, []).append(face)
    paths = np.concatenate([recording.base_pose[:, :2], recording.ee_pose[:, :2]])
    low, high = paths.min(axis=0) - _NEAR, paths.max(axis=0) + _NEAR
    near = {
        name
        for name, one in scene.objects.items()
        if np.all((one.pose[:2] > low) & (one.pose[:2] < high))
    }
    return [
        faces
        for name, faces in things.items()
        if name in near and not surrounds(scene, scene.objects[name])
    ]


def _draw_side(
    axes: Axes, robot: Robot, recording: Recording, furniture: Sequence[list[Painted]]
) -> None:
    drawn = moments(recording)
    view = _side_view(recording, drawn)
    faces = [
        Painted(face.corners, _pale(ARM if face.arm else BODY, place, len(drawn)))
        for place, moment in enumerate(drawn)
        for face in robot_faces(
            robot, recording.base_pose[moment], recording.joint_positions[moment]
        )
    ]
    faces += [face for thing in furniture for face in thing]
    corners = np.concatenate([face.corners for face in faces] + [recording.desired[:, :3]])
    draw_floor(axes, view, corners)
    _draw_paths(axes, recording, view, floor=recording.base_pose[:, :3])
    # What stands about interlocks; robots alone are sorted well enough, and quicker.
    (paint_solids if furniture else draw_solids)(axes, view, faces)
    for goal in recording.goals:
        _draw_goal(axes, goal, view)
    show_to_scale(axes)


def _side_view(recording: Recording, drawn: NDArray[np.intp]) -> View:
    """Return the view along the way from that side on which the body hides least of the arm."""
    travel = recording.goal[:2] - recording.base_pose[0, :2]
    heading = float(np.arctan2(travel[1], travel[0]))
    arm = (recording.ee_pose[drawn, :3] - recording.base_pose[drawn, :3]) * [1.0, 1.0, 0.0]
    views = [look(heading + turn, _ELEVATION) for turn in (_TURN, np.pi - _TURN)]
    return max(views, key=lambda view: float(np.mean(arm @ view.toward)))


def _draw_top(axes: Axes, robot: Robot, recording: Recording) -> None:
    view = look(0.0, np.pi / 2.0)
    drawn = moments(recording)
    for place, moment in enumerate(drawn):
        _draw_footprint(axes, robot, recording, moment, _pale(BODY, place, len(drawn)))
        reach = np.stack([recording.base_pose[moment, :2], recording.ee_pose[moment, :2]])
        axes.plot(*reach.T, color=_pale(ARM, place, len(drawn)), lw=3.0, zorder=2.5,
                  solid_capstyle="round")  # fmt: skip
    _draw_paths(axes, recording, view, floor=recording.base_pose[:, :3])
    _draw_headings(axes, recording)
    for goal in recording.goals:
        _draw_goal(axes, goal, view)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    axes.set(xlabel="x (m)", ylabel="y (m)")


def _draw_footprint(
    axes: Axes, robot: Robot, recording: Recording, moment: int, colour: tuple[float, float, float]
) -> None:
    """Draw the outline of all that the arm does not move, from above."""
    pose, joints = recording.base_pose[moment], recording.joint_positions[moment]
    body = [face.corners[:, :2] for face in robot_faces(robot, pose, joints) if not face.arm]
    if not body:
        return
    _draw_outline(axes, np.concatenate(body), (*colour, 0.55), 2.0)


def _draw_outline(axes: Axes, points: Array, colour: tuple[float, ...], order: float) -> None:
    outline = points[ConvexHull(points[:, :2]).vertices, :2]
    axes.add_patch(Polygon(outline, facecolor=colour, edgecolor="#9aa2ad", lw=0.9, zorder=order))


def _draw_headings(axes: Axes, recording: Recording) -> None:
    """Draw an arrow along the base's heading at even distances of its path."""
    at = moments(recording, _ARROW_METRES, 12)
    pose = recording.base_pose[at]
    heading = spatial.yaw(pose)
    axes.quiver(
        pose[:, 0], pose[:, 1], np.cos(heading), np.sin(heading), color=BASE, zorder=6,
        angles="xy", units="inches", scale_units="inches", scale=4.2, width=0.026, pivot="tail",
    )  # fmt: skip


def _draw_paths(axes: Axes, recording: Recording, view: View, floor: Array) -> None:
    base, ee = view.flat(floor), view.flat(recording.ee_pose[:, :3])
    desired = view.flat(recording.desired[:, :3])
    axes.plot(*base.T, color=BASE, lw=2.2, zorder=2.8)
    axes.plot(*ee.T, color=EE, lw=2.4, zorder=7, path_effects=_CASING)
    axes.plot(*desired.T, color=DESIRED, lw=1.2, ls=(0, (4, 3)), zorder=8)
    failed = ~recording.feasible
    axes.plot(*ee[failed].T, "o", color=FAILURE, ms=5.0, mew=0.0, zorder=12)
    axes.plot(*ee[:1].T, "o", color="white", mec=EE, mew=2.0, ms=8.0, zorder=10)
    axes.plot(*base[:1].T, "o", color="white", mec=BASE, mew=2.0, ms=8.0, zorder=6.5)


def _draw_goal(axes: Axes, goal: Array, view: View) -> None:
    place = goal[:3]
    foot = view.flat(np.stack([place, place * [1.0, 1.0, 0.0]]))
    axes.plot(*foot.T, color=GOAL, lw=1.3, ls=":", zorder=6)
    axes.plot(*foot[:1].T, "*", color=GOAL, mec=INK, mew=0.7, ms=17.0, zorder=11)


def _pale(colour: str, place: int, count: int) -> tuple[float, float, float]:
    """Return `colour`, the paler the earlier: `place` 0 of `count` is the palest."""
    share = _PALEST * (1.0 - place / max(count - 1, 1))
    red, green, blue = (part + (1.0 - part) * share for part in to_rgb(colour))
    return red, green, blue


def _legend() -> list[Line2D]:
    def entry(name: str, **look: object) -> Line2D:
        return Line2D([], [], label=name, **look)  # type: ignore[arg-type]

    return [
        entry("base path and heading", color=BASE, lw=2.2, marker=">", ms=7),
        entry("arm, base to EE", color=ARM, lw=3.0),
        entry("EE desired", color=DESIRED, lw=1.2, ls=(0, (4, 3))),
        entry("EE achieved", color=EE, lw=2.4),
        entry("no IK solution", color=FAILURE, lw=0, marker="o", ms=6),
        entry("start", color="white", lw=0, marker="o", mec=DESIRED, mew=2.0, ms=8),
        entry("goal", color=GOAL, lw=0, marker="*", mec=INK, mew=0.7, ms=15),
    ]
