"""Demonstrations and what was learned from them, side by side and from above."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from scipy.spatial.transform import Rotation

from kinfeas.core import registry
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.spatial import IDENTITY, Array, compose, distance, integrate, make_pose, relative
from kinfeas.io.demonstrations import Demonstration
from kinfeas.scenes.demonstrate import Take
from kinfeas.scenes.exercise import Corners, Exercise
from kinfeas.viz.pictures.style import BASE, DESIRED, EE, FAINT, GOAL, STYLE

_DT = 0.1  # s
_MOST_STEPS = 1500
_STARTS = 7
_ARRIVED = (1e-3, 0.01)  # m, rad
# Palm, wrist and fingers of a gripper in one line, in its own frame, metres.
_GRIPPER = np.array(
    [[0.0, -0.025], [-0.045, -0.025], [-0.045, 0.0], [-0.075, 0.0], [-0.045, 0.0], [-0.045, 0.025],
     [0.0, 0.025]]
)  # fmt: skip
_CASING = [patheffects.withStroke(linewidth=3.6, foreground="white", alpha=0.9)]
_WOOD, _EDGE, _SHELF = "#dcc096", "#a9834f", "#eef0f3"
_LIMITS = ((-0.68, 0.68), (-1.08, 0.44))  # m
_BASE_RADIUS = 0.045  # m, as drawn


def demonstrations_figure(mechanism: str, exercise: Exercise, takes: Sequence[Take]) -> Figure:
    """Return a picture of all takes, and of the shipped motions from starts of their own.

    Both are seen in the frame of the handle, with the approach upward.

    Args:
        mechanism: Whose shipped models `MECHANISM_grasp` and `MECHANISM_open` are run.
        exercise: Where its joint and its outlines are.
        takes: What was demonstrated.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(10.0, 6.3), layout="constrained")
        shown, learned = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes in (shown, learned):
            _draw_furniture(axes, exercise)
        _draw_takes(shown, takes)
        _draw_motions(learned, mechanism)
        shown.set_title(f"{len(takes)} demonstrations, the {mechanism} in as many places")
        learned.set_title(f"The learned motions, from {_STARTS} other starts")
        shown.set_ylabel("toward the furniture (m)")
        for axes in (shown, learned):
            axes.set(xlim=_LIMITS[0], ylim=_LIMITS[1], aspect="equal")
            axes.set_xlabel("right of the handle (m)")
        figure.legend(handles=_legend(), loc="outside lower center", ncols=6, handlelength=1.4)
    return figure


def run_motion(
    generator: MotionGenerator, start: Array, target: Array, dt: float = _DT
) -> list[Array]:
    """Return the poses that a motion comes through, each of shape (n, 7), until all arrive.

    Args:
        generator: What moves.
        start: Where n motions begin, shape (n, 7).
        target: What they head for, or the poses of the objects, shape (n, 7).
        dt: Seconds between two poses.
    """
    state = generator.start(start, target, [np.random.default_rng(0) for _ in start])
    path = [start]
    for _ in range(_MOST_STEPS):
        metres, radians = distance(path[-1], generator.goal_pose(state, target))
        if np.all(metres < _ARRIVED[0]) and np.all(radians < _ARRIVED[1]):
            break
        twist, state = generator.twist(state, path[-1], target, np.full(len(start), dt))
        path.append(integrate(path[-1], twist, dt))
    return path


def _draw_takes(axes: Axes, takes: Sequence[Take]) -> None:
    for take in takes:
        for one, colour in ((take.grasp, FAINT), (take.open, DESIRED)):
            _line(axes, _seen(one.ee_pose, one), color=colour, lw=1.3, alpha=0.7)
            _line(axes, _seen(one.base_pose, one), color=BASE, lw=1.0, alpha=0.45)
    first = takes[0]
    for one, colour, moments in ((first.grasp, FAINT, [0]), (first.open, DESIRED, [0, -1])):
        for moment in moments:
            _draw_base(axes, _seen(one.base_pose, one)[moment])
        _draw_grippers(axes, _seen(one.ee_pose, one), colour)


def _draw_base(axes: Axes, pose: Array) -> None:
    """Draw a disc that looks where the base does."""
    ahead = compose(pose, np.array([_BASE_RADIUS, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    x, y = _above(pose)
    axes.add_patch(
        Circle((x, y), _BASE_RADIUS, facecolor="#dbe6f3", edgecolor=BASE, lw=1.4, zorder=4.0)
    )
    _line(axes, np.stack([pose, ahead]), color=BASE, lw=1.6, zorder=4.5)


def _seen(pose: Array, shown: Demonstration) -> Array:
    return relative(pose, shown.object_pose)


def _draw_motions(axes: Axes, mechanism: str) -> None:
    grasp, pull = (
        registry.build("kinfeas.motion_generators", "imitation", {"model": f"{mechanism}_{motion}"})
        for motion in ("grasp", "open")
    )
    start = _starts()
    target = np.tile(IDENTITY, (_STARTS, 1))
    reached = np.stack(run_motion(grasp, start, target))
    pulled = np.stack(run_motion(pull, reached[-1], target))
    for number in range(_STARTS):
        _line(axes, reached[:, number], color=EE, lw=1.6, alpha=0.8)
        _draw_gripper(axes, start[number], EE)
    _line(axes, pulled[:, 0], color=DESIRED, lw=2.2)
    _draw_grippers(axes, pulled[:, 0], DESIRED)
    axes.plot(*_above(pulled[-1:, 0]).T, "o", ms=8, color=GOAL, mec="white", zorder=6)


def _starts() -> Array:
    """Return where the hands begin: on an arc around the handle, turned every way."""
    bearing = np.deg2rad(np.linspace(-75.0, 75.0, _STARTS))
    reach = np.where(np.arange(_STARTS) % 2, 0.5, 0.62)
    position = np.stack([-reach * np.cos(bearing), -reach * np.sin(bearing), 0.2 * bearing], -1)
    turns = np.random.default_rng(3).uniform(-1.0, 1.0, (_STARTS, 3)) * [0.4, 0.4, 1.2]
    return make_pose(position, Rotation.from_rotvec(turns))


def _draw_furniture(axes: Axes, exercise: Exercise) -> None:
    handle = exercise.handle

    def outline(poses: Array, **how: Any) -> None:
        axes.add_patch(Polygon(_above(relative(poses, handle)), closed=True, **how))

    outline(_corners(exercise.body), facecolor=_SHELF, edgecolor="#c9ced6", lw=1.0, zorder=0.5)
    for share in (0.25, 0.5, 0.75, 0.0, 1.0):
        corners = [
            exercise.joint.carry(one, share * exercise.plan.opening)
            for one in _corners(exercise.part)
        ]
        fill = {0.0: 0.4, 1.0: 1.0}.get(share)
        if fill is not None or exercise.joint.kind == "hinge":
            outline(
                np.stack(corners), facecolor=(_WOOD, fill or 0.0), lw=0.9, zorder=1.0,
                edgecolor=(_EDGE, 1.0 if share == 1.0 else 0.35),
            )  # fmt: skip
    axes.plot(0.0, 0.0, "s", ms=6, color=GOAL, mec="white", zorder=6)


def _corners(corners: Corners) -> Array:
    """Return the four corners of a rectangle from two opposite ones, as poses (4, 7)."""
    (x0, y0), (x1, y1) = corners
    poses = np.tile(IDENTITY, (4, 1))
    poses[:, :2] = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    return poses


def _above(pose: Array) -> Array:
    """Return points of the handle's frame as drawn: its x upward, its y to the left."""
    return np.stack([-pose[..., 1], pose[..., 0]], axis=-1)


def _line(axes: Axes, pose: Array, **how: Any) -> None:
    axes.plot(*_above(pose).T, solid_capstyle="round", **{"zorder": 3.0, **how})


def _draw_grippers(axes: Axes, pose: Array, colour: str) -> None:
    """Draw the gripper along a path: at its start, its end and evenly between."""
    way = np.concatenate([[0.0], np.cumsum(distance(pose[1:], pose[:-1])[0])])
    count = 1 + max(1, round(way[-1] / 0.18))
    for moment in np.searchsorted(way, np.linspace(0.0, way[-1], count)).clip(0, len(way) - 1):
        _draw_gripper(axes, pose[moment], colour)


def _draw_gripper(axes: Axes, pose: Array, colour: str) -> None:
    """Draw a gripper whose fingers end at the tool tip."""
    points = np.tile(IDENTITY, (len(_GRIPPER), 1))
    points[:, :2] = _GRIPPER
    axes.plot(
        *_above(compose(pose, points)).T, color=colour, lw=1.7, zorder=5.0,
        solid_joinstyle="miter", path_effects=_CASING,
    )  # fmt: skip


def _legend() -> list[Line2D]:
    def line(colour: str, label: str) -> Line2D:
        return Line2D([], [], color=colour, lw=2.0, label=label)

    def point(marker: str, label: str) -> Line2D:
        return Line2D([], [], ls="", marker=marker, ms=7, mfc=GOAL, mec="white", label=label)

    return [
        point("s", "handle"),
        line(FAINT, "hand, reaching"),
        line(DESIRED, "hand, pulling"),
        line(BASE, "base of the hand"),
        line(EE, "from a start to the grasp"),
        point("o", "learned end"),
    ]
