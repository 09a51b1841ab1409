"""Robots and scenes as primitive shapes with colours."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from kinfeas.backends.physics.visuals import GREY, VisualShape, urdf_visuals
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.evaluation.recording import Recording
from kinfeas.robots.elements import read_xml
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape
from kinfeas.scenes.objects import SceneObject
from kinfeas.scenes.scene import Scene
from kinfeas.viz.style import ARM, BODY

SIDES = 16
"""Sides of a cylinder."""

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
"""Corners of the unit cube, shape (8, 3)."""

LOW, HIGH, HIGHEST = "#d8c7a6", "#9fa9b580", 1.2
"""Colours of solids: up to a height in metres, and higher ones."""

_TURN = np.deg2rad(12.0)  # of a side view, so that the arm is in front
_STICK = 0.03  # m, width of lines in place of links without shapes
_BOX_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


class Part(NamedTuple):
    """A shape in the frame of a link, and whether it belongs to the arm."""

    link: str
    shape: Shape
    arm: bool


class Solid(NamedTuple):
    """A shape with its world pose and a colour, `#rrggbb` or with opacity `#rrggbbaa`."""

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
    """Yield the visible shapes of a scene in the world with the name of their object."""
    for name, entry in scene.objects.items():
        poses = entry.link_poses()
        for visual in scene_shapes(name, entry):
            pose = compose(poses[visual.link[1]], visual.shape.pose)
            yield name, Solid(replace(visual.shape, pose=pose), visual.colour)


def scene_shapes(name: str, entry: SceneObject) -> list[VisualShape]:
    """Return the visible shapes of an object in the frames of its links.

    Links without visible primitives show those of their collision geometry.
    """
    visuals, shapes = _visuals(name, entry.urdf_path), []
    for link in entry.urdf.links.values():
        grey = [VisualShape((name, link.name), shape, GREY) for shape in link.shapes]
        shapes += visuals.get(link.name, grey)
    return shapes


@lru_cache(maxsize=64)
def _visuals(name: str, path: Path) -> dict[str, list[VisualShape]]:
    """Return the visible shapes of a URDF in the frames of their links, by link."""
    visuals: dict[str, list[VisualShape]] = {}
    for visual in urdf_visuals(name, read_xml(path, "robot")):
        visuals.setdefault(visual.link[1], []).append(visual)
    return visuals


def solid_shapes(solids: Solids | None) -> dict[int, Solid]:
    """Return the solids of one row by place; high ones are translucent."""
    if solids is None:
        return {}
    shapes = {}
    for slot in np.flatnonzero(solids.filled[0]).tolist():
        x, y, low, high = solids.size[0, slot].tolist()
        height, centre = high - low, solids.centre[0, slot]
        if solids.cylinder[0, slot]:
            shape = Shape("cylinder", (x, height), centre)
        else:
            shape = Shape("box", (2.0 * x, 2.0 * y, height), centre)
        shapes[slot] = Solid(shape, HIGH if high > HIGHEST else LOW)
    return shapes


def side_heading(recording: Recording) -> float:
    """Return the world heading to the right of a side view in which the arm is in front."""
    travel = recording.goal[:2] - recording.base_pose[0, :2]
    heading = float(np.arctan2(travel[1], travel[0]))
    arm = (recording.ee_pose[:, :2] - recording.base_pose[:, :2]).mean(axis=0)
    headings = (heading + _TURN, heading + np.pi - _TURN)
    return max(headings, key=lambda angle: float(arm @ [np.sin(angle), -np.cos(angle)]))


def surrounds(scene: Scene, entry: SceneObject) -> bool:
    """Return whether an object, such as walls, is as large as the room."""
    points = corners([Solid(shape, "") for _, shape in entry.shapes()])
    return bool(np.max(np.ptp(points, axis=0)) >= min(scene.size))


def corners(solids: Iterable[Solid]) -> Array:
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
    turn = rotation(shape.pose).as_matrix()
    return [face @ turn.T + shape.pose[:3] for face in polygons]


def _lathed(radii: Array, heights: Array) -> list[Array]:
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(SIDES)], axis=1)
    rings = [radius * circle + [0, 0, z] for radius, z in zip(radii, heights, strict=True)]
    polygons = [rings[0][::-1], rings[-1]]
    for low, high in pairwise(rings):
        after = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        polygons += list(np.stack([low, *after, high], axis=1))
    return polygons
