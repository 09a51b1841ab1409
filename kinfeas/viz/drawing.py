"""Robots, scenes and paths as 3-D pictures: primitive shapes drawn by matplotlib."""

from collections.abc import Iterable, Iterator, Sequence
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
from kinfeas.kinematics.forward import FIXED, Tree, build_tree
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
_LIGHT_TURN = np.array([[0.7, -0.7], [0.7, 0.7]])  # 45 degrees to the side of the viewer
_FILL = 0.97  # share of the axes that is used


class Part(NamedTuple):
    """A shape in the frame of the moving joint that carries it; joint -1 is the base."""

    joint: int
    shape: Shape
    arm: bool


class Solid(NamedTuple):
    """A shape with its world pose and a colour."""

    shape: Shape
    colour: str


def robot_solids(
    robot: Robot, base_pose: Array, joint_positions: Array, colours: tuple[str, str] = (BODY, ARM)
) -> list[Solid]:
    """Return the shapes of a robot in the world.

    Args:
        robot: Robot model.
        base_pose: World pose of the base, shape (7,).
        joint_positions: Arm joints, shape (j,).
        colours: Of the body, and of the arm with its hand.
    """
    tree, parts = robot_parts(robot)
    poses = compose(base_pose, joint_poses(tree, joint_positions))
    return [Solid(_placed(part.shape, poses[part.joint]), colours[part.arm]) for part in parts]


@lru_cache(maxsize=8)
def robot_parts(robot: Robot) -> tuple[Tree, list[Part]]:
    """Return the tree of moving joints and the shapes that each joint carries.

    Joints without shapes carry a thin box to each of their links.
    """
    tree, mounts = build_tree(robot)
    path = robot.urdf.path_to(robot.ee_frame)
    arm = {joint.child for joint in path} | robot.urdf.below(path[-1].name)
    poses = {
        name: make_pose(mount.offset, Rotation.from_matrix(mount.rotation))
        for name, mount in mounts.items()
    }
    parts = [
        Part(mount.joint, _placed(shape, poses[name]), mount.joint != FIXED and name in arm)
        for name, mount in mounts.items()
        for shape in robot.urdf.links[name].shapes
    ]
    shown = {part.joint for part in parts}
    for joint in robot.urdf.joints.values():
        parent, child = mounts[joint.parent], mounts[joint.child]
        carried = child.joint == parent.joint
        end = child.offset if carried else tree.offset[child.joint]
        lines = [(parent.offset, end)]
        if not carried and tree.prismatic[child.joint]:
            along = tree.rotation[child.joint][:, 2]
            lines.append((end + joint.lower * along, end + joint.upper * along))
        if parent.joint not in shown:
            parts += [Part(parent.joint, one, joint.child in arm) for one in _sticks(lines)]
    return tree, parts


def joint_poses(tree: Tree, joint_positions: Array) -> Array:
    """Return the poses of all moving joints in the base frame, (m + 1, 7); the last is the base."""
    count = len(tree.parent)
    rotations, positions = np.tile(np.eye(3), (count + 1, 1, 1)), np.zeros((count + 1, 3))
    values = tree.multiplier * joint_positions[tree.variable] + tree.bias
    for i, parent in enumerate(tree.parent):
        turned = rotations[parent] @ tree.rotation[i]
        positions[i] = positions[parent] + rotations[parent] @ tree.offset[i]
        if tree.prismatic[i]:
            positions[i] += turned[:, 2] * values[i]
            rotations[i] = turned
        else:
            rotations[i] = turned @ Rotation.from_rotvec([0.0, 0.0, values[i]]).as_matrix()
    return make_pose(positions, Rotation.from_matrix(rotations))


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
    """Return new 3-D axes without a frame.

    Args:
        figure: Its figure.
        position: As in `Figure.add_subplot`, or its rectangle in the figure.
        heading: World direction that points to the right of the picture, radians.
        elevation: Angle from which to look down, radians.
    """
    add: Any = figure.add_axes if isinstance(position, tuple) else figure.add_subplot
    axes = add(position, projection="3d", proj_type="ortho", computed_zorder=False)
    axes.view_init(elev=np.rad2deg(elevation), azim=np.rad2deg(heading) - 90.0)
    axes.set_axis_off()
    return axes


def show_all(axes: Axes3D, points: Array, aspect: float = 1.0) -> None:
    """Fit 3-D axes to points at equal scales, after all is drawn.

    Args:
        axes: From `add_axes`.
        points: World positions, shape (k, 3), metres.
        aspect: Width of the picture by its height; mplot3d uses a square otherwise.
    """
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
    light = np.array([*(rotated @ level[:2] for rotated in _LIGHT_TURN), 0.9])
    light /= np.linalg.norm(light)
    seen, colours = [], []
    for solid in solids:
        for face in faces(solid.shape):
            normal = _normal(face)
            if normal @ toward > 0.0:
                # mplot3d needs the same number of corners everywhere.
                seen.append(np.pad(face, ((0, _SIDES - len(face)), (0, 0)), mode="edge"))
                brightness = _DARKEST + (1.0 - _DARKEST) * (0.5 + 0.5 * normal @ light)
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


def _placed(shape: Shape, pose: Array) -> Shape:
    return Shape(shape.kind, shape.size, compose(pose, shape.pose))


def _sticks(lines: Iterable[tuple[Array, Array]]) -> Iterator[Shape]:
    for first, last in lines:
        way = last - first
        length = float(np.linalg.norm(way))
        if 1e-6 < length < np.inf:
            turn, _ = Rotation.align_vectors(way[np.newaxis], [[0.0, 0.0, 1.0]])
            size = (_STICK, _STICK, length + _STICK)
            yield Shape("box", size, make_pose((first + last) / 2.0, turn))


def _lathed(radii: Array, heights: Array) -> list[Array]:
    """Return the faces of a profile turned about z; radii and heights of shape (p,)."""
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [
        np.column_stack([radius * circle, np.full(_SIDES, height)])
        for radius, height in zip(radii, heights, strict=True)
    ]
    found = [rings[0][::-1], rings[-1]]
    for low, high in pairwise(rings):
        for i in range(_SIDES):
            j = (i + 1) % _SIDES
            found.append(np.array([low[i], low[j], high[j], high[i]]))
    return found


def _normal(face: Array) -> Array:
    """Return the outward unit normal of a polygon, shape (3,)."""
    normal = np.cross(face[1:-1] - face[0], face[2:] - face[0]).sum(axis=0)
    return normal / max(float(np.linalg.norm(normal)), 1e-12)
