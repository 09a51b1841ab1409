"""Pictures of robots and scenes, with solids and floors in 3-D, drawn by matplotlib."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from kinfeas.core.spatial import IDENTITY, Array, rotation
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.viz import shapes
from kinfeas.viz.shapes import CORNERS, VisualShape, faces
from kinfeas.viz.style import ARM, BODY, EE, INK, STYLE

_AXES = {"approach": "#d1483e", "finger axis": "#3a9a52"}
_AXIS_LENGTH, _AXIS_FRACTION = 0.2, 0.3  # m, and at most this fraction of the robot's size
_SMALL = 0.8  # m; smaller robots have a finer grid
_CASING = [patheffects.withStroke(linewidth=3.0, foreground="white", alpha=0.9)]


def robot_figure(robot: Robot) -> Figure:
    """Return a picture of a robot at home from two sides, with the axes of its gripper."""
    solids = shapes.robot_solids(robot, IDENTITY, robot.home["home"])
    points = shapes.corners(solids)
    size = float(np.ptp(points, axis=0).max())
    tip, axes_of_gripper = _gripper_axes(robot)
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 5.6), layout="constrained")
        grid = figure.add_gridspec(1, 2)
        for column, heading in enumerate(np.deg2rad([-35.0, 55.0])):
            axes = add_axes(figure, grid[column], heading, np.deg2rad(18.0))
            floor = draw_floor(axes, points, 0.5 if size > _SMALL else 0.1)
            draw_solids(axes, solids)
            for colour, direction in zip(_AXES.values(), axes_of_gripper, strict=True):
                ends = np.stack([tip, tip + min(_AXIS_LENGTH, _AXIS_FRACTION * size) * direction])
                axes.plot(*ends.T, color=colour, lw=3.0, zorder=9)
                axes.plot(*ends[1:].T, "o", color=colour, ms=6.0, zorder=9)
            show_all(axes, np.concatenate([points, floor]))
        figure.suptitle(f"{robot.name} at home, {len(robot.arm)} arm joints", fontsize=13)
        handles = [Patch(color=ARM, label="arm and EE"), Patch(color=BODY, label="base and body")]
        lines = [Line2D([], [], color=_AXES[name], lw=2.5, label=name) for name in _AXES]
        figure.legend(handles=[*handles, *lines], loc="outside lower center", ncols=4)
    return figure


def scene_figure(scene: Scene) -> Figure:
    """Return a picture of a scene with the paths of its handles."""
    # Objects as large as the room, such as its walls, hide the others.
    names = scene.objects.keys() - shapes.surrounding(scene) or scene.objects.keys()
    half, paths = np.array([*scene.size, 0.0]) / 2.0, []
    for name, handle in scene.handles.items():
        joint = handle.joint and scene.objects[handle.object].urdf.joints[handle.joint]
        if not joint or joint.kind == "continuous":
            continue
        at = scene.objects[handle.object].joint_positions[joint.name]
        states = [
            scene.with_joints({handle.object: {joint.name: position}})
            for position in np.linspace(at, shapes.far_end(joint, at), 30).tolist()
        ]
        paths.append(np.stack([state.handle_pose(name)[:3] for state in states]))
    solids = [solid for solid in shapes.scene_solids(scene) if solid.link[0] in names]
    with rc_context(STYLE):
        figure = Figure(figsize=(10.0, 7.2))
        points = shapes.corners(solids) if solids else np.stack([-half, half])
        heading = shapes.heading_from_middle(points)
        axes = add_axes(figure, (0.0, 0.0, 1.0, 0.95), heading, np.deg2rad(38.0))
        floor = draw_floor(axes, np.clip(points, -half, half), 1.0, 0.0)
        if solids:
            draw_solids(axes, solids)
        for path in paths:
            axes.plot(*path.T, color=EE, lw=2.0, zorder=7, path_effects=_CASING)
        for name in scene.handles:
            axes.plot(*scene.handle_pose(name)[:3, np.newaxis], "o", color=EE, ms=5.0, zorder=8)
        for name in names:
            furniture = shapes.corners([solid for solid in solids if solid.link[0] == name])
            position = (*furniture.mean(axis=0)[:2], furniture[:, 2].max() + 0.1)
            axes.text(*position, name, fontsize=9, color=INK, ha="center", zorder=9,
                      path_effects=_CASING)  # fmt: skip
        show_all(axes, np.concatenate([points * [1.0, 1.0, 1.2], floor]), 1.4)
        axes.set_title(f"{scene.name}: {scene.size[0]:g} x {scene.size[1]:g} m, grid of 1 m")
    return figure


def _gripper_axes(robot: Robot) -> tuple[Array, Array]:
    """Return the tool tip at home (3,), and the directions of `_AXES`, (2, 3)."""
    ee = forward(build_chain(robot), robot.home["home"][np.newaxis])[0]
    tip = ee[:3] + rotation(ee).apply(robot.tool_tip)
    to_gripper = np.concatenate([np.zeros(3), robot.gripper_rotation])
    return tip, (rotation(ee) * rotation(to_gripper).inv()).as_matrix().T[:2]


_DARKEST = 0.55
_LIGHT = np.array([0.48, -0.36, 0.8])  # world direction to the light
_TOLERANCE = 1e-6  # m, distance from a plane that counts as zero
_FILL = 0.97  # fraction of the axes that the content fills


def add_axes(figure: Figure, position: Any, heading: float, elevation: float) -> Axes3D:
    """Return 3-D axes without a frame.

    Args:
        figure: Figure that gets the axes.
        position: Position as in `Figure.add_subplot`, or a rectangle in the figure.
        heading: World direction that points right in the picture, radians.
        elevation: Angle by which the camera looks down, radians.
    """
    add: Any = figure.add_axes if isinstance(position, tuple) else figure.add_subplot
    axes = add(position, projection="3d", proj_type="ortho", computed_zorder=False)
    axes.view_init(elev=np.rad2deg(elevation), azim=np.rad2deg(heading) - 90.0)
    axes.set_axis_off()
    return axes


def show_all(axes: Axes3D, points: Array, aspect: float = 1.0) -> None:
    """Fit 3-D axes of `aspect` (width by height) to points (k, 3) at equal scales; call it last."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 0.1)
    axes.set(xlim=(low[0], low[0] + size[0]), ylim=(low[1], low[1] + size[1]))
    axes.set_zlim(low[2], low[2] + size[2])
    axes.set_box_aspect(size.tolist())
    box = low + size * (CORNERS + 0.5)
    x, y, _ = proj_transform(*box.T, axes.get_proj())
    zoom = _FILL * axes.viewLim.width / max(np.ptp(x) / aspect, np.ptp(y))
    axes.set_box_aspect(size.tolist(), zoom=zoom)
    for artist in (*axes.lines, *axes.collections):  # mplot3d clips to the square
        artist.set(clip_on=False, in_layout=False)


class _Polygons(PolyCollection):
    """Polygons in 3-D, each of shape (k, 3), drawn in the order of the sequence."""

    def __init__(self, polygons: Sequence[Array], **looks: Any) -> None:
        super().__init__([], **looks)
        self._points, sizes = np.concatenate(polygons), [len(polygon) for polygon in polygons]
        self._starts = np.cumsum(sizes)[:-1]

    def do_3d_projection(self) -> float:
        axes: Any = self.axes
        x, y, _ = proj_transform(*self._points.T, axes.get_proj())
        self.set_verts(np.split(np.column_stack([x, y]), self._starts))
        return 0.0


class Face(NamedTuple):
    """A polygon (k, 3) in the world, its normal (3,) and its colour (4,)."""

    corners: Array
    normal: Array
    colour: Array


def draw_solids(axes: Axes3D, solids: Sequence[VisualShape]) -> None:
    """Draw solids, shaded and sorted by depth."""
    elevation, azimuth = np.deg2rad([axes.elev, axes.azim])
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * np.cos(elevation)
    toward = level + np.array([0.0, 0.0, np.sin(elevation)])
    visible = []
    for solid in solids:
        for face in faces(solid.shape):
            normal = np.cross(face[1:-1] - face[0], face[2:] - face[0]).sum(axis=0)
            normal /= max(float(np.linalg.norm(normal)), 1e-12)
            if normal @ toward > 0.0:
                brightness = _DARKEST + (1.0 - _DARKEST) * (0.5 + 0.5 * normal @ _LIGHT)
                colour = np.array(to_rgba(solid.colour)) * [*[brightness] * 3, 1.0]
                visible.append(Face(face, normal, colour))
    if visible:
        polygons, _, colours = zip(*back_to_front(visible), strict=True)
        # Edges hide the seams between cut faces; translucent faces would show them twice.
        widths = [0.5 if colour[3] == 1.0 else 0.0 for colour in colours]
        looks: dict[str, Any] = {"facecolors": colours, "edgecolors": colours, "linewidths": widths}
        drawn = _Polygons(polygons, **looks, joinstyle="bevel", zorder=3)
        axes.add_collection(drawn, autolim=False)


def back_to_front(faces: list[Face]) -> list[Face]:
    """Return faces, all toward the viewer, in drawing order: none hides a later one.

    A binary space partition: the plane of one face divides the others, and cuts some of them. Those
    behind the plane come before this face, those in front of it after.
    """
    ordered, waiting = list[Face](), [faces]
    while waiting:
        group = waiting.pop()
        if len(group) < 2:
            ordered += group
            continue
        divider = group.pop(len(group) // 2)
        behind, before = list[Face](), list[Face]()
        for face in group:
            height = (face.corners - divider.corners[0]) @ divider.normal
            if height.max() <= _TOLERANCE:
                behind.append(face)
            elif height.min() >= -_TOLERANCE:
                before.append(face)
            else:
                after = np.roll(height, -1)
                fraction = np.where(height * after < 0.0, height, np.nan) / (height - after)
                step = np.roll(face.corners, -1, axis=0) - face.corners
                cuts = face.corners + fraction[:, np.newaxis] * step
                corners = np.stack([face.corners, cuts], axis=1).reshape(-1, 3)
                side = np.column_stack([height, fraction * 0.0]).ravel()
                behind.append(face._replace(corners=corners[side <= 0.0]))
                before.append(face._replace(corners=corners[side >= 0.0]))
        waiting += [before, [divider], behind]
    return ordered


def draw_floor(axes: Axes3D, points: Array, cell: float = 0.5, margin: float = 0.1) -> Array:
    """Draw a grid below points, shape (k, 3); return its opposite corners, shape (2, 3)."""
    low = np.floor((points[:, :2].min(axis=0) - margin) / cell) * cell
    high = np.ceil((points[:, :2].max(axis=0) + margin) / cell) * cell
    xs, ys = (
        np.linspace(a, b, min(round((b - a) / cell), 200) + 1)
        for a, b in zip(low, high, strict=True)
    )
    lines = [[(x, low[1], 0.0), (x, high[1], 0.0)] for x in xs]
    lines += [[(low[0], y, 0.0), (high[0], y, 0.0)] for y in ys]
    grid = Line3DCollection(lines, colors="#e3e6ea", linewidths=0.7, zorder=1)
    axes.add_collection(grid, autolim=False)
    return np.array([[*low, 0.0], [*high, 0.0]])
