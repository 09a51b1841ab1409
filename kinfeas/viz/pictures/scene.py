"""A scene at a glance: the whole room, and each handle with the way that it can go."""

from collections.abc import Iterator

import numpy as np
from matplotlib import patheffects, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.urdf import Joint, Shape
from kinfeas.scenes.objects import SceneObject, moving_joint
from kinfeas.scenes.scene import Scene
from kinfeas.viz.pictures.projection import Colour, Painted, View, look
from kinfeas.viz.pictures.raster import paint_solids
from kinfeas.viz.pictures.solids import polygons
from kinfeas.viz.pictures.style import EE, INK, STYLE

_WOODS = ("#d3ad7a", "#c4503f", "#a2866a", "#c2a988", "#b3bcc4", "#aab692")
_WALL, _LEAF, _HANDLE, _FLOOR = "#ffffff", "#ecd5ab", "#434951", "#f5f6f8"
_OVERVIEW = look(np.deg2rad(28.0), np.deg2rad(38.0))
_ASIDE, _DOWN = np.deg2rad(38.0), np.deg2rad(24.0)  # from where a handle is looked at
_NEAR = 0.8  # m, of what else is drawn with a handle
_OPEN = 0.6  # share of the way that a handle is drawn at
_MOST = 4  # close views
_STACK = 0.4  # m, between the middles of what is labelled as one
_CASING = [patheffects.withStroke(linewidth=3.0, foreground="white", alpha=0.9)]


def scene_figure(scene: Scene) -> Figure:
    """Return a picture of the scene from a corner, with a close view of each of its handles."""
    shown = list(scene.handles)[:_MOST]
    with rc_context(STYLE):
        figure = Figure(figsize=(12.5 if shown else 9.0, 7.2), layout="constrained")
        if not shown:
            _draw_room(figure.subplots(), scene)
            return figure
        grid = figure.add_gridspec(len(shown), 2, width_ratios=(2.1, 1.0))
        _draw_room(figure.add_subplot(grid[:, 0]), scene)
        for row, name in enumerate(shown):
            _draw_handle(figure.add_subplot(grid[row, 1]), scene, name)
    return figure


def _draw_room(axes: Axes, scene: Scene) -> None:
    view, half = _OVERVIEW, np.array(scene.size) / 2.0
    _draw_ground(axes, view, half)
    faces = [face for _, face in scene_faces(scene) if not _hides(face, half, view)]
    paint_solids(axes, view, faces, max(scene.size) / 1000.0)
    for names, top in _stacks(scene):
        _label(
            axes, names, np.array([*view.flat(top.mean(axis=0))[:1], view.flat(top)[:, 1].max()])
        )
    for name in scene.handles:
        place = view.flat(scene.handle_pose(name)[:3])
        axes.plot(*place, "o", color=EE, ms=5.0, mec="white", mew=0.8, zorder=8)
    _finish(axes, f"{scene.name}: {scene.size[0]:g} x {scene.size[1]:g} m, grid of 1 m")


def _draw_handle(axes: Axes, scene: Scene, name: str) -> None:
    """Draw a handle with what it moves most of the way open, and the path that it takes."""
    handle = scene.handles[name]
    back = -rotation(scene.handle_pose(name)).as_matrix()[:, 0]
    side = np.arctan2(back[1], back[0]) + _ASIDE
    view = look(float(side + np.pi / 2.0), _DOWN)
    middle = scene.objects[handle.object].pose[:2]
    path, opened = _path(scene, name)
    near = [
        other
        for other, one in opened.objects.items()
        if np.linalg.norm(one.pose[:2] - middle) < _NEAR and not surrounds(opened, one)
    ]
    paint_solids(axes, view, [face for other, face in scene_faces(opened) if other in near], 0.0015)
    title = name
    if handle.joint is not None:
        joint = scene.objects[handle.object].urdf.joints[handle.joint]
        title = f"{name}: {joint.name} {_reach(joint)}"
        axes.plot(*view.flat(path).T, color=EE, lw=2.0, zorder=7, path_effects=_CASING)
        axes.plot(*view.flat(path[-1]), "o", color=EE, mec="white", ms=6.0, zorder=8)
    axes.plot(*view.flat(path[0]), "o", color="white", mec=EE, mew=2.0, ms=7.0, zorder=8)
    _finish(axes, title)


def _reach(joint: Joint) -> str:
    if joint.kind == "continuous":
        return "without end"
    turns = joint.kind == "revolute"
    return f"of {np.rad2deg(joint.upper):.0f} degrees" if turns else f"of {joint.upper:g} m"


def _path(scene: Scene, name: str) -> tuple[Array, Scene]:
    """Return the places (k, 3) that a handle comes through, and the scene with it well open."""
    handle = scene.handles[name]
    if handle.joint is None:
        return scene.handle_pose(name)[np.newaxis, :3], scene
    joint = scene.objects[handle.object].urdf.joints[handle.joint]
    if joint.kind == "continuous":
        return scene.handle_pose(name)[np.newaxis, :3], scene

    def at(share: float) -> Scene:
        return scene.with_joints({handle.object: {joint.name: share * joint.upper}})

    path = [at(share).handle_pose(name)[:3] for share in np.linspace(0.0, 1.0, 30)]
    return np.stack(path), at(_OPEN)


def painted_shapes(scene: Scene) -> Iterator[tuple[str, Shape, Colour]]:
    """Yield each shape in the world, with its object and a colour.

    What is moved by a joint is lighter than what is not, and what has a handle's frame is dark.
    """
    kinds = [one.urdf_path for one in scene.objects.values() if not surrounds(scene, one)]
    kinds = list(dict.fromkeys(kinds))
    held = {(handle.object, handle.link) for handle in scene.handles.values()}
    for name, one in scene.objects.items():
        body = _WALL
        if not surrounds(scene, one):
            body = _WOODS[kinds.index(one.urdf_path) % len(_WOODS)]
        for link, shape in one.shapes():
            moved = _LEAF if moving_joint(one.urdf, link) else body
            yield name, shape, _HANDLE if (name, link) in held else moved


def scene_faces(scene: Scene) -> Iterator[tuple[str, Painted]]:
    """Yield each face in the world with the name of its object."""
    for name, shape, colour in painted_shapes(scene):
        for corners in polygons(shape):
            yield name, Painted(corners, colour)


def _hides(face: Painted, half: Array, view: View) -> bool:
    """Return whether a face stands at the edge of the floor on the viewer's side."""
    middle = face.corners.mean(axis=0)
    outward = np.where(np.abs(middle[:2]) >= half - 1e-9, np.sign(middle[:2]), 0.0)
    return float(outward @ view.toward[:2]) > 0.0


def surrounds(scene: Scene, one: SceneObject) -> bool:
    """Return whether an object, such as walls, is as large as the room."""
    low, high = _bounds(one)
    return bool(np.max(high - low) >= min(scene.size))


def _stacks(scene: Scene) -> list[tuple[list[str], Array]]:
    """Return the names of what stands on one another, the highest first, and its top (4, 3)."""
    tops = {name: _top(one) for name, one in scene.objects.items() if not surrounds(scene, one)}
    stacks: list[tuple[list[str], Array]] = []
    for name in sorted(tops, key=lambda name: -tops[name][0, 2]):
        for names, top in stacks:
            if np.linalg.norm((top - tops[name]).mean(axis=0)[:2]) < _STACK:
                names.append(name)
                break
        else:
            stacks.append(([name], tops[name]))
    return stacks


def _draw_ground(axes: Axes, view: View, half: Array) -> None:
    corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    corners[:, :2] *= half
    axes.add_patch(Polygon(view.flat(corners), facecolor=_FLOOR, edgecolor="none", zorder=0.5))
    for axis in (0, 1):
        for at in np.arange(-np.floor(half[axis]), half[axis] + 1e-9, 1.0):
            ends = np.zeros((2, 3))
            ends[:, axis], ends[:, 1 - axis] = at, [-half[1 - axis], half[1 - axis]]
            axes.plot(*view.flat(ends).T, color="#dde1e6", lw=0.8, zorder=1.0)


def _label(axes: Axes, names: list[str], place: Array) -> None:
    axes.annotate(
        "\n".join(names), tuple(place), (0.0, 5.0), textcoords="offset points", ha="center",
        fontsize=9, color=INK, zorder=9, path_effects=_CASING,
    )  # fmt: skip


def _finish(axes: Axes, title: str) -> None:
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.04)
    axes.set_axis_off()
    axes.set_title(title)


def _bounds(one: SceneObject) -> tuple[Array, Array]:
    points = np.concatenate([face for _, shape in one.shapes() for face in polygons(shape)])
    return points.min(axis=0), points.max(axis=0)


def _top(one: SceneObject) -> Array:
    """Return the corners of the upper side of an object's bounds, shape (4, 3)."""
    low, high = _bounds(one)
    return np.array([[x, y, high[2]] for x in (low[0], high[0]) for y in (low[1], high[1])])
