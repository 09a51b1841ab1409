"""The robot's primitive shapes as flat faces in the world, ready to be drawn."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.kinematics.forward import FIXED, Mount, Tree, build_tree
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Shape

_SIDES = 20
"""Flat sides that a cylinder is drawn with."""

_STICK = 0.03
"""Metres, the width of a line that stands for links without shapes."""

_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


@dataclass(frozen=True, eq=False)
class Face:
    """A flat polygon, its corners counter-clockwise when seen from outside.

    Attributes:
        corners: Shape (k, 3), metres.
        arm: Whether it belongs to what IK moves on the way to the EE, or to the gripper.
    """

    corners: Array
    arm: bool


def robot_faces(robot: Robot, base_pose: Array, joint_positions: Array) -> list[Face]:
    """Return the faces of all shapes of `robot` in the world.

    Args:
        robot: Whose shapes.
        base_pose: World pose of the base, shape (7,).
        joint_positions: Arm joints, shape (j,).
    """
    tree, faces = parts(robot)
    rotations, positions = bodies(tree, joint_positions)
    turn, place = spatial.rotation(base_pose).as_matrix(), base_pose[:3]
    found = []
    for body, face in faces:
        seen = face.corners @ rotations[body].T + positions[body]
        found.append(Face(seen @ turn.T + place, face.arm))
    return found


@lru_cache(maxsize=8)
def parts(robot: Robot) -> tuple[Tree, list[tuple[int, Face]]]:
    """Return the tree and each face with the joint that carries it, in that joint's frame.

    Bodies without shapes are drawn as sticks to what they carry.
    """
    tree, mounts = build_tree(robot)
    arm, faces = _arm_links(robot), []
    for link in robot.urdf.links.values():
        mount = mounts[link.name]
        for shape in link.shapes:
            for corners in polygons(shape):
                placed = corners @ mount.rotation.T + mount.offset
                moves = mount.joint != FIXED and link.name in arm
                faces.append((mount.joint, Face(placed, moves)))
    shown = {joint for joint, _ in faces}
    sticks = _sticks(robot, tree, mounts)
    bare = [(body, link, corners) for body, link, corners in sticks if body not in shown]
    return tree, faces + [(body, Face(corners, link in arm)) for body, link, corners in bare]


def _sticks(robot: Robot, tree: Tree, mounts: dict[str, Mount]) -> Iterator[tuple[int, str, Array]]:
    """Yield the faces of a stick to each link, and of rails: carrying joint, link and corners."""
    for joint in robot.urdf.joints.values():
        parent, child = mounts[joint.parent], mounts[joint.child]
        carried = child.joint == parent.joint
        end = child.offset if carried else tree.offset[child.joint]
        sticks = [(parent.offset, end)]
        if not carried and tree.prismatic[child.joint]:
            along = tree.rotation[child.joint][:, 2]
            sticks.append((end + joint.lower * along, end + joint.upper * along))
        for first, last in sticks:
            for corners in _stick(first, last):
                yield parent.joint, joint.child, corners


def _stick(first: Array, last: Array) -> list[Array]:
    way = last - first
    length = float(np.linalg.norm(way))
    if not 1e-6 < length < np.inf:
        return []
    turn, _ = Rotation.align_vectors(way[np.newaxis], [[0.0, 0.0, 1.0]])
    size = (_STICK, _STICK, length + _STICK)
    return polygons(Shape("box", size, spatial.make_pose((first + last) / 2.0, turn)))


def _arm_links(robot: Robot) -> set[str]:
    """Return the links from the root to the EE and all that the EE carries."""
    links = {joint.child for joint in robot.urdf.path_to(robot.ee_frame)}
    carried = [robot.ee_frame]
    while carried:
        link = carried.pop()
        links.add(link)
        carried += [joint.child for joint in robot.urdf.joints.values() if joint.parent == link]
    return links


def bodies(tree: Tree, joint_positions: Array) -> tuple[Array, Array]:
    """Return rotation (m + 1, 3, 3) and position (m + 1, 3) of the bodies; the last is the base."""
    count = len(tree.parent)
    rotations, positions = np.tile(np.eye(3), (count + 1, 1, 1)), np.zeros((count + 1, 3))
    values = tree.multiplier * joint_positions[tree.variable] + tree.bias
    for i, parent in enumerate(tree.parent):
        rotation = rotations[parent] @ tree.rotation[i]
        positions[i] = positions[parent] + rotations[parent] @ tree.offset[i]
        if tree.prismatic[i]:
            positions[i] += rotation[:, 2] * values[i]
            rotations[i] = rotation
        else:
            rotations[i] = rotation @ Rotation.from_rotvec([0.0, 0.0, values[i]]).as_matrix()
    return rotations, positions


def polygons(shape: Shape) -> list[Array]:
    """Return the faces of a shape in its link's frame, each (k, 3)."""
    if shape.kind == "box":
        corners = _CORNERS * np.array(shape.size)
        faces = [corners[list(face)] for face in _BOX_FACES]
    elif shape.kind == "cylinder":
        radius, length = shape.size
        faces = _turned(np.array([radius, radius]), np.array([-length / 2.0, length / 2.0]))
    else:
        latitude = np.linspace(-np.pi / 2.0, np.pi / 2.0, 9)
        faces = _turned(shape.size[0] * np.cos(latitude), shape.size[0] * np.sin(latitude))
    turn = spatial.rotation(shape.pose).as_matrix()
    return [face @ turn.T + shape.pose[:3] for face in faces]


def _turned(radii: NDArray[np.float64], heights: NDArray[np.float64]) -> list[Array]:
    """Return the faces of the body that a profile, turned about z, encloses; shapes (p,), (p,)."""
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [
        np.column_stack([radius * circle, np.full(_SIDES, height)])
        for radius, height in zip(radii, heights, strict=True)
    ]
    faces = [rings[0][::-1], rings[-1]]
    for low, high in pairwise(rings):
        for i in range(_SIDES):
            j = (i + 1) % _SIDES
            faces.append(np.array([low[i], low[j], high[j], high[i]]))
    return faces
