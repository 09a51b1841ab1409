"""Solids, floors and axes as 3-D pictures, drawn by matplotlib."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from kinfeas.core.spatial import Array
from kinfeas.viz.shapes import CORNERS, SIDES, Solid, faces

_DARKEST = 0.55
_LIGHT = np.array([0.48, -0.36, 0.8])  # world direction to the light
_FILL = 0.97  # share of the axes that is used


def add_axes(figure: Figure, position: Any, heading: float, elevation: float) -> Axes3D:
    """Return 3-D axes without a frame; `heading` points right, `elevation` down, in radians.

    The position is as in `Figure.add_subplot`, or a rectangle in the figure.
    """
    add: Any = figure.add_axes if isinstance(position, tuple) else figure.add_subplot
    axes = add(position, projection="3d", proj_type="ortho", computed_zorder=False)
    axes.view_init(elev=np.rad2deg(elevation), azim=np.rad2deg(heading) - 90.0)
    axes.set_axis_off()
    return axes


def show_all(axes: Axes3D, points: Array, aspect: float = 1.0) -> None:
    """Fit 3-D axes to points (k, 3) at equal scales; call it last. aspect: width by height."""
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


def draw_solids(axes: Axes3D, solids: Sequence[Solid]) -> None:
    """Draw solids, shaded and sorted by depth."""
    elevation, azimuth = np.deg2rad([axes.elev, axes.azim])
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * np.cos(elevation)
    toward = level + np.array([0.0, 0.0, np.sin(elevation)])
    polygons, colours = [], []
    for solid in solids:
        for face in faces(solid.shape):
            normal = _normal(face)
            if normal @ toward > 0.0:
                # mplot3d needs the same number of corners everywhere.
                polygons.append(np.pad(face, ((0, SIDES - len(face)), (0, 0)), mode="edge"))
                brightness = _DARKEST + (1.0 - _DARKEST) * (0.5 + 0.5 * normal @ _LIGHT)
                colours.append(np.array(to_rgba(solid.colour)) * [*[brightness] * 3, 1.0])
    if polygons:
        edges = [colour * [0.85, 0.85, 0.85, 1.0] for colour in colours]
        axes.add_collection(
            Poly3DCollection(
                polygons, facecolors=colours, edgecolors=edges, linewidths=0.25, zorder=3
            ),
            autolim=False,
        )


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


def _normal(face: Array) -> Array:
    normal = np.cross(face[1:-1] - face[0], face[2:] - face[0]).sum(axis=0)
    return normal / max(float(np.linalg.norm(normal)), 1e-12)
