"""A robot's shapes at its home, and the axes of its hand."""

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from kinfeas.core.spatial import IDENTITY, Array, rotation
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.viz.pictures.projection import Painted, View, draw_floor, look, show_to_scale
from kinfeas.viz.pictures.raster import paint_solids
from kinfeas.viz.pictures.solids import robot_faces
from kinfeas.viz.pictures.style import ARM, BODY, STYLE

_AXES = {"approach": "#d1483e", "finger to finger": "#3a9a52"}
_LENGTH = 0.2  # m
_TURNS, _ELEVATION = np.deg2rad([-35.0, 55.0]), np.deg2rad(18.0)


def robot_figure(robot: Robot) -> Figure:
    """Return a picture of a robot at its home, from two sides, with what its hand takes for what.

    Arrows at the tool tip show where the gripper approaches and from finger to finger.
    """
    home = robot.home["home"]
    faces = [
        Painted(face.corners, ARM if face.arm else BODY)
        for face in robot_faces(robot, IDENTITY, home)
    ]
    arrows = _arrows(robot)
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 5.6), layout="constrained")
        for axes, turn in zip(figure.subplots(1, 2), _TURNS, strict=True):
            _draw(axes, look(float(turn), float(_ELEVATION)), faces, arrows)
        figure.suptitle(f"{robot.name} at its home, {len(robot.arm)} arm joints", fontsize=13)
        handles = [Patch(color=ARM, label="arm and hand"), Patch(color=BODY, label="the rest")]
        lines = [Line2D([], [], color=_AXES[name], lw=2.5, label=name) for name in _AXES]
        figure.legend(handles=[*handles, *lines], loc="outside lower center", ncols=4)
    return figure


def _arrows(robot: Robot) -> dict[str, Array]:
    """Return both ends of each arrow in the world, shape (2, 3), metres."""
    ee = forward(build_chain(robot), robot.home["home"][np.newaxis])[0]
    tip = ee[:3] + rotation(ee).apply(robot.tool_tip)
    to_gripper = np.concatenate([np.zeros(3), robot.gripper_rotation])
    axes = (rotation(ee) * rotation(to_gripper).inv()).as_matrix().T
    return {
        name: np.stack([tip, tip + _LENGTH * axis])
        for name, axis in zip(_AXES, axes[:2], strict=True)
    }


def _draw(axes: Axes, view: View, faces: list[Painted], arrows: dict[str, Array]) -> None:
    draw_floor(axes, view, np.concatenate([face.corners for face in faces]))
    paint_solids(axes, view, faces)
    for name, ends in arrows.items():
        start, end = view.flat(ends)
        style = {"arrowstyle": "-|>", "color": _AXES[name], "lw": 2.5, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, start, arrowprops=style, zorder=9)
    show_to_scale(axes)
