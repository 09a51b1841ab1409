"""Pictures of a robot and of a scene."""

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from kinfeas.core.spatial import IDENTITY, Array, rotation
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.viz import drawing, shapes
from kinfeas.viz.style import ARM, BODY, EE, INK, STYLE

_AXES = {"approach": "#d1483e", "finger axis": "#3a9a52"}
_LENGTH = 0.2  # m, of the axes
_OPEN = 0.6  # share of a joint's range
_CASING = [patheffects.withStroke(linewidth=3.0, foreground="white", alpha=0.9)]


def robot_figure(robot: Robot) -> Figure:
    """Return a picture of a robot at home from two sides, with the axes of its gripper."""
    solids = shapes.robot_solids(robot, IDENTITY, robot.home["home"])
    tip, axes_of_gripper = _gripper_axes(robot)
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 5.6), layout="constrained")
        grid = figure.add_gridspec(1, 2)
        for column, heading in enumerate(np.deg2rad([-35.0, 55.0])):
            axes = drawing.add_axes(figure, grid[column], heading, np.deg2rad(18.0))
            points = shapes.corners(solids)
            floor = drawing.draw_floor(axes, points)
            drawing.draw_solids(axes, solids)
            for colour, direction in zip(_AXES.values(), axes_of_gripper, strict=True):
                ends = np.stack([tip, tip + _LENGTH * direction])
                axes.plot(*ends.T, color=colour, lw=3.0, zorder=9)
                axes.plot(*ends[1:].T, "o", color=colour, ms=6.0, zorder=9)
            drawing.show_all(axes, np.concatenate([points, floor]))
        figure.suptitle(f"{robot.name} at home, {len(robot.arm)} arm joints", fontsize=13)
        handles = [Patch(color=ARM, label="arm and EE"), Patch(color=BODY, label="base and body")]
        lines = [Line2D([], [], color=_AXES[name], lw=2.5, label=name) for name in _AXES]
        figure.legend(handles=[*handles, *lines], loc="outside lower center", ncols=4)
    return figure


def scene_figure(scene: Scene) -> Figure:
    """Return a picture of a scene with doors and drawers open, and the paths of their handles."""
    names = {name for name, entry in scene.objects.items() if not shapes.surrounds(scene, entry)}
    half = np.array([*scene.size, 0.0]) / 2.0
    opened, paths = scene, []
    for name, handle in scene.handles.items():
        joint = handle.joint and scene.objects[handle.object].urdf.joints[handle.joint]
        if not joint or joint.kind == "continuous":
            continue
        states = [
            scene.with_joints({handle.object: {joint.name: fraction * joint.upper}})
            for fraction in np.linspace(0.0, 1.0, 30)
        ]
        paths.append(np.stack([state.handle_pose(name)[:3] for state in states]))
        opened = opened.with_joints({handle.object: {joint.name: _OPEN * joint.upper}})
    solids = [(name, solid) for name, solid in shapes.scene_solids(opened) if name in names]
    with rc_context(STYLE):
        figure = Figure(figsize=(10.0, 7.2))
        axes = drawing.add_axes(figure, (0.0, 0.0, 1.0, 0.95), np.deg2rad(28.0), np.deg2rad(38.0))
        drawing.draw_floor(axes, np.array([-half, half]), 1.0, 0.0)
        drawing.draw_solids(axes, [solid for _, solid in solids])
        for path in paths:
            axes.plot(*path.T, color=EE, lw=2.0, zorder=7, path_effects=_CASING)
        for name in scene.handles:
            axes.plot(*scene.handle_pose(name)[:3, np.newaxis], "o", color=EE, ms=5.0, zorder=8)
        for name in names:
            points = shapes.corners([solid for other, solid in solids if other == name])
            position = (*points.mean(axis=0)[:2], points[:, 2].max() + 0.1)
            axes.text(*position, name, fontsize=9, color=INK, ha="center", zorder=9,
                      path_effects=_CASING)  # fmt: skip
        points = shapes.corners([solid for _, solid in solids])
        drawing.show_all(axes, points * [1.0, 1.0, 1.2], 1.4)
        axes.set_title(f"{scene.name}: {scene.size[0]:g} x {scene.size[1]:g} m, grid of 1 m")
    return figure


def _gripper_axes(robot: Robot) -> tuple[Array, Array]:
    """Return the tool tip at home (3,), and the directions of `_AXES`, (2, 3)."""
    ee = forward(build_chain(robot), robot.home["home"][np.newaxis])[0]
    tip = ee[:3] + rotation(ee).apply(robot.tool_tip)
    to_gripper = np.concatenate([np.zeros(3), robot.gripper_rotation])
    return tip, (rotation(ee) * rotation(to_gripper).inv()).as_matrix().T[:2]
