"""Robots, scenes and paths as 3-D pictures: primitive shapes drawn by matplotlib."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.objects import SceneObject, moving_joint
from kinfeas.scenes.scene import Scene
from kinfeas.viz.style import ARM, BODY

_SIDES = 16  # of a cylinder
_STICK = 0.03  # m, width of lines in place of links without shapes
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_WOODS = ("#d3ad7a", "#c4503f", "#a2866a", "#c2a988", "#b3bcc4", "#aab692")
_WALL, _LEAF, _HANDLE = "#ffffff", "#ecd5ab", "#434951"
_DARKEST = 0.55
_LIGHT = np.array([0.48, -0.36, 0.8])  # world direction to the light
_FILL = 0.97  # share of the axes that is used


class Part(NamedTuple):
    """A shape in the frame of a link, and whether it belongs to the arm."""

    link: str
    shape: Shape
    arm: bool


class Solid(NamedTuple):
    """A shape with its world pose and a colour."""

    shape: Shape
    colour: str


def robot_solids(
    robot: Robot, base_pose: Array, joint_positions: Array, colours: tuple[str, ...] = (BODY, ARM)
) -> list[Solid]:
    """Return the shapes of a robot at a base pose (7,) and arm joints (j,); colours: body, arm."""
    poses = link_poses(robot, base_pose, joint_positions)
    return [
        Solid(replace(shape, pose=compose(poses[link], shape.pose)), colours[arm])
        for link, shape, arm in robot_parts(robot)
    ]


@lru_cache(maxsize=8)
def robot_parts(robot: Robot) -> list[Part]:
    """Return the shapes of a robot; thin boxes connect links without shapes."""
    path = robot.urdf.path_to(robot.ee_frame)
    while len(path) > 1 and (not path[0].moves or path[0].name in robot.fixed_joints):
        path = path[1:]
    arm = {joint.child for joint in path} | robot.urdf.below(path[-1].name)
    links = robot.urdf.links
    parts = [
        Part(name, shape, name in arm) for name, link in links.items() for shape in link.shapes
    ]
    for joint in robot.urdf.joints.values():
        length = float(np.linalg.norm(joint.origin[:3]))
        if length > 1e-6 and not links[joint.parent].shapes and not links[joint.child].shapes:
            turn, _ = Rotation.align_vectors(joint.origin[np.newaxis, :3], [[0.0, 0.0, 1.0]])
            pose = make_pose(joint.origin[:3] / 2.0, turn)
            shape = Shape("box", (_STICK, _STICK, length + _STICK), pose)
            parts.append(Part(joint.parent, shape, joint.child in arm))
    return parts


def link_poses(robot: Robot, base_pose: Array, joint_positions: Array) -> dict[str, Array]:
    """Return the world poses (7,) of a robot's links by name; arguments as in `robot_solids`."""
    names = (joint.name for joint in robot.arm)
    positions = {**robot.fixed_joints, **dict(zip(names, joint_positions.tolist(), strict=True))}
    return robot.urdf.link_poses(positions, base_pose)


def scene_solids(scene: Scene) -> Iterator[tuple[str, Solid]]:
    """Yield the shapes of a scene in the world with the name of their object.

    Links that a joint moves are lighter than the body, and links with a handle are dark.
    """
    urdfs = [one.urdf_path for one in scene.objects.values() if not surrounds(scene, one)]
    urdfs = list(dict.fromkeys(urdfs))
    held = {(handle.object, handle.link) for handle in scene.handles.values()}
    for name, one in scene.objects.items():
        body = _WALL
        if not surrounds(scene, one):
            body = _WOODS[urdfs.index(one.urdf_path) % len(_WOODS)]
        for link, shape in one.shapes():
            moved = _LEAF if moving_joint(one.urdf, link) else body
            yield name, Solid(shape, _HANDLE if (name, link) in held else moved)


def surrounds(scene: Scene, one: SceneObject) -> bool:
    """Return whether an object, such as walls, is as large as the room."""
    points = corners([Solid(shape, "") for _, shape in one.shapes()])
    return bool(np.max(np.ptp(points, axis=0)) >= min(scene.size))


def corners(solids: Iterable[Solid]) -> Array:
    """Return the corners of the faces of solids in the world, shape (k, 3), metres."""
    return np.concatenate([face for solid in solids for face in faces(solid.shape)])


def faces(shape: Shape) -> list[Array]:
    """Return the polygons (k, 3) around a shape, their corners counter-clockwise from outside."""
    if shape.kind == "box":
        corners = _CORNERS * np.array(shape.size)
        found = [corners[list(face)] for face in _BOX_FACES]
    elif shape.kind == "cylinder":
        radius, length = shape.size
        found = _lathed(np.array([radius, radius]), np.array([-length / 2.0, length / 2.0]))
    else:
        latitude = np.linspace(-np.pi / 2.0, np.pi / 2.0, 7)
        found = _lathed(shape.size[0] * np.cos(latitude), shape.size[0] * np.sin(latitude))
    turn = rotation(shape.pose).as_matrix()
    return [face @ turn.T + shape.pose[:3] for face in found]


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
    box = low + size * (_CORNERS + 0.5)
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
    seen, colours = [], []
    for solid in solids:
        for face in faces(solid.shape):
            normal = _normal(face)
            if normal @ toward > 0.0:
                # mplot3d needs the same number of corners everywhere.
                seen.append(np.pad(face, ((0, _SIDES - len(face)), (0, 0)), mode="edge"))
                brightness = _DARKEST + (1.0 - _DARKEST) * (0.5 + 0.5 * normal @ _LIGHT)
                colours.append(brightness * np.array(to_rgb(solid.colour)))
    if seen:
        edges = [0.85 * colour for colour in colours]
        axes.add_collection(
            Poly3DCollection(seen, facecolors=colours, edgecolors=edges, linewidths=0.25, zorder=3),
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


def _lathed(radii: Array, heights: Array) -> list[Array]:
    """Return the faces of a profile turned about z; radii and heights of shape (p,)."""
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)], axis=1)
    rings = [radius * circle + [0, 0, z] for radius, z in zip(radii, heights, strict=True)]
    found = [rings[0][::-1], rings[-1]]
    for low, high in pairwise(rings):
        after = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        found += list(np.stack([low, *after, high], axis=1))
    return found


def _normal(face: Array) -> Array:
    """Return the outward unit normal of a polygon, shape (3,)."""
    normal = np.cross(face[1:-1] - face[0], face[2:] - face[0]).sum(axis=0)
    return normal / max(float(np.linalg.norm(normal)), 1e-12)
