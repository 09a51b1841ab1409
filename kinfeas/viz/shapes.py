"""Robots and scenes as primitive shapes with colours."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.backends.physics.backend import ROBOT, LinkName
from kinfeas.backends.physics.robot import physics_urdf
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.robots.elements import Element, parse_xml, read_xml
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint, Shape
from kinfeas.robots.urdf_file import read_shapes
from kinfeas.scenes.scene import Scene
from kinfeas.viz.style import ARM, BODY

GREY = "#b3b3b3"
"""Colour of shapes without a material."""

SIDES = 16
"""Sides of a cylinder."""

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
"""Corners of the unit cube, shape (8, 3)."""

LOW, HIGH, HIGHEST = "#d8c7a6", "#9fa9b580", 1.2
"""Colours of low and of high solids, and the height between them, metres."""

_SOLID = "/solid"  # stands for an object's name in the `LinkName` of a solid
_RANGE = 3.0  # rad, largest shown angle to either side, for joints without limits
_STICK = 0.03  # m, width of lines in place of links without shapes
_BOX_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


class VisualShape(NamedTuple):
    """A visible primitive of a link, in its frame, and its colour, `#rrggbb` or `#rrggbbaa`."""

    link: LinkName
    shape: Shape
    colour: str


def robot_solids(
    robot: Robot, base_pose: Array, joint_positions: Array, colours: tuple[str, str] = (BODY, ARM)
) -> list[VisualShape]:
    """Return the shapes of a robot in the world; arguments as in `robot_poses`, `robot_shapes`."""
    return placed(robot_shapes(robot, colours), robot_poses(robot, base_pose, joint_positions))


def placed(shapes: Iterable[VisualShape], poses: Mapping[LinkName, Array]) -> list[VisualShape]:
    """Return shapes in the world from those in the frames of their links, by the links' poses."""
    return [
        VisualShape(link, replace(shape, pose=compose(poses[link], shape.pose)), colour)
        for link, shape, colour in shapes
    ]


@lru_cache(maxsize=8)
def robot_shapes(robot: Robot, colours: tuple[str, str] = (BODY, ARM)) -> list[VisualShape]:
    """Return a robot's shapes, in `colours` of body and arm; thin boxes stand for missing ones."""
    path = robot.urdf.path_to(robot.ee_frame)
    while len(path) > 1 and (not path[0].moves or path[0].name in robot.fixed_joints):
        path = path[1:]
    arm = {joint.child for joint in path} | robot.urdf.below(path[-1].name)
    links = robot.urdf.links
    shapes = [
        VisualShape((ROBOT, name), shape, colours[name in arm])
        for name, link in links.items()
        for shape in link.shapes
    ]
    for joint in robot.urdf.joints.values():
        length = float(np.linalg.norm(joint.origin[:3]))
        if length > 1e-6 and not links[joint.parent].shapes and not links[joint.child].shapes:
            orientation, _ = Rotation.align_vectors(joint.origin[np.newaxis, :3], [[0.0, 0.0, 1.0]])
            pose = make_pose(joint.origin[:3] / 2.0, orientation)
            shape = Shape("box", (_STICK, _STICK, length + _STICK), pose)
            shapes.append(VisualShape((ROBOT, joint.parent), shape, colours[joint.child in arm]))
    return shapes


def robot_poses(robot: Robot, base_pose: Array, joint_positions: Array) -> dict[LinkName, Array]:
    """Return the world poses of a robot's links at a base pose (7,) and arm joints (j,)."""
    names = (joint.name for joint in robot.arm)
    positions = {**robot.fixed_joints, **dict(zip(names, joint_positions.tolist(), strict=True))}
    poses = robot.urdf.link_poses(positions, base_pose)
    return {(ROBOT, link): pose for link, pose in poses.items()}


def far_end(joint: Joint, position: float) -> float:
    """Return the end of a joint's range that is farther from its position."""
    ends = min(joint.upper, _RANGE), max(joint.lower, -_RANGE)
    return max(ends, key=lambda end: abs(end - position))


def scene_solids(scene: Scene) -> list[VisualShape]:
    """Return the visible shapes of a scene in the world."""
    return placed(scene_shapes(scene), scene_poses(scene))


def scene_poses(scene: Scene) -> dict[LinkName, Array]:
    """Return the world poses of the links of a scene."""
    objects = scene.objects.items()
    return {(name, k): pose for name, entry in objects for k, pose in entry.link_poses().items()}


def scene_shapes(scene: Scene) -> list[VisualShape]:
    """Return the visible shapes of a scene in the frames of their links.

    Links without visible primitives show those of their collision geometry.
    """
    shapes = []
    for name, entry in scene.objects.items():
        visuals = _visuals(name, entry.urdf_path)
        for link in entry.urdf.links.values():
            grey = [VisualShape((name, link.name), shape, GREY) for shape in link.shapes]
            shapes += visuals.get(link.name, grey)
    return shapes


def visual_shapes(robot: Robot) -> list[VisualShape]:
    """Return the visible primitives of a robot in a physics world; meshes are left out."""
    urdf, _ = physics_urdf(robot)
    return list(urdf_visuals(ROBOT, parse_xml(urdf, "robot", str(robot.urdf_path))))


@lru_cache(maxsize=64)
def _visuals(name: str, path: Path) -> dict[str, list[VisualShape]]:
    """Return the visible shapes of a URDF in the frames of their links, by link."""
    visuals: dict[str, list[VisualShape]] = {}
    for visual in urdf_visuals(name, read_xml(path, "robot")):
        visuals.setdefault(visual.link[1], []).append(visual)
    return visuals


def urdf_visuals(owner: str, urdf: Element) -> Iterator[VisualShape]:
    """Return the visible primitives of a URDF, whose object is named `owner`."""
    colours = {item.get("name"): _colour(item) for item in urdf.xml.findall("material")}
    for link in urdf.children("link"):
        for visual in link.children("visual"):
            material = visual.xml.find("material")
            colour = None if material is None else _colour(material)
            if material is not None and colour is None:
                colour = colours.get(material.get("name"))
            for shape in read_shapes(visual):
                yield VisualShape((owner, link.text("name")), shape, colour or GREY)


def _colour(material: Any) -> str | None:
    colour = material.find("color")
    if colour is None:
        return None
    red, green, blue, *_ = (min(max(float(part), 0.0), 1.0) for part in colour.get("rgba").split())
    return "#" + bytes(round(255.0 * fraction) for fraction in (red, green, blue)).hex()


def solid_shapes(solids: Solids | None) -> list[VisualShape]:
    """Return the solids of one row in the world; high ones are translucent."""
    if solids is None:
        return []
    shapes = []
    for slot in np.flatnonzero(solids.filled[0]).tolist():
        x, y, low, high = solids.size[0, slot].tolist()
        height, centre = high - low, solids.centre[0, slot]
        if solids.cylinder[0, slot]:
            shape = Shape("cylinder", (x, height), centre)
        else:
            shape = Shape("box", (2.0 * x, 2.0 * y, height), centre)
        shapes.append(VisualShape((_SOLID, str(slot)), shape, HIGH if high > HIGHEST else LOW))
    return shapes


def surrounding(scene: Scene) -> set[str]:
    """Return the names of objects that are as large as the room, such as walls."""
    around = set()
    for name, entry in scene.objects.items():
        points = corners(VisualShape((name, ""), shape, "") for _, shape in entry.shapes())
        if np.max(np.ptp(points, axis=0)) >= min(scene.size):
            around.add(name)
    return around


def heading_from_middle(points: Array) -> float:
    """Return the heading of a view from the middle of the room, where furniture is open.

    The heading, in radians, is the world direction that points right in the picture. Of four it is
    the one whose camera looks best at points (k, 3); the first one if they surround the middle.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    headings = np.deg2rad(28.0) + np.pi / 2.0 * np.arange(4)
    if np.all((low < 0.0) & (high > 0.0)):
        return float(headings[0])
    toward_viewer = np.stack([np.sin(headings), -np.cos(headings)], axis=1)
    return float(headings[np.argmin(toward_viewer @ (low + high))])


def corners(solids: Iterable[VisualShape]) -> Array:
    """Return the corners of the faces of solids in the world, shape (k, 3), metres."""
    return np.concatenate([face for solid in solids for face in faces(solid.shape)])


def faces(shape: Shape) -> list[Array]:
    """Return the polygons (k, 3) around a shape, their corners counter-clockwise from outside."""
    if shape.kind == "box":
        points = CORNERS * np.array(shape.size)
        polygons = [points[list(face)] for face in _BOX_FACES]
    elif shape.kind == "cylinder":
        radius, length = shape.size
        polygons = _lathed(np.array([radius, radius]), np.array([-length / 2.0, length / 2.0]))
    else:
        latitude = np.linspace(-np.pi / 2.0, np.pi / 2.0, 7)
        polygons = _lathed(shape.size[0] * np.cos(latitude), shape.size[0] * np.sin(latitude))
    matrix = rotation(shape.pose).as_matrix()
    return [face @ matrix.T + shape.pose[:3] for face in polygons]


def _lathed(radii: Array, heights: Array) -> list[Array]:
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(SIDES)], axis=1)
    rings = [radius * circle + [0, 0, z] for radius, z in zip(radii, heights, strict=True)]
    polygons = [rings[0][::-1], rings[-1]]
    for low, high in pairwise(rings):
        after = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        polygons += list(np.stack([low, *after, high], axis=1))
    return polygons
