"""The chain from base to EE as plain arrays that numba kernels read."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint

FIXED = -1


class Tree(NamedTuple):
    """m moving joints, each after its parent, and the body that each one carries.

    Every joint moves about or along the z axis of its own frame: the rotation that takes the
    URDF's axis there is folded into the constant transforms before and after it, so that a joint
    costs one mixing of two columns.

    Attributes:
        parent: Joint that carries joint i, shape (m,); -1 is the robot's base.
        rotation: From the parent's body to the joint, shape (m, 3, 3).
        offset: Same, metres, shape (m, 3).
        prismatic: Whether the joint slides, shape (m,).
        variable: Arm variable that drives it, shape (m,).
        multiplier: Joint position per unit of the variable, shape (m,); 1 but for mimic joints.
        bias: Joint position at variable 0, shape (m,).
    """

    parent: NDArray[np.intp]
    rotation: Array
    offset: Array
    prismatic: NDArray[np.bool_]
    variable: NDArray[np.intp]
    multiplier: Array
    bias: Array


class Mount(NamedTuple):
    """Where a link sits: rigidly on the body of a joint.

    Attributes:
        joint: Index into the tree; -1 is the robot's base.
        rotation: From that body to the link, shape (3, 3).
        offset: Same, metres, shape (3,).
    """

    joint: int
    rotation: Array
    offset: Array


class Chain(NamedTuple):
    """A serial tree (parent of i is i - 1) with the EE frame on its last body.

    Attributes:
        tree: The joints on the way to the EE.
        ee_rotation: From the last body to the EE frame, shape (3, 3).
        ee_offset: Same, metres, shape (3,).
        variables: How many the arm has, those included that move nothing here.
    """

    tree: Tree
    ee_rotation: Array
    ee_offset: Array
    variables: int


class _Drive(NamedTuple):
    variable: int
    multiplier: float
    bias: float


class _Segment(NamedTuple):
    parent: int
    rotation: Array
    offset: Array
    prismatic: bool
    drive: _Drive


def build_tree(robot: Robot, tip: str | None = None) -> tuple[Tree, dict[str, Mount]]:
    """Return the moving joints of `robot` and where each of its links is mounted.

    Joints that the arm does not drive stand at `robot.fixed_joints`.

    Args:
        robot: The robot.
        tip: Only the joints on the way from the root to this link; all joints by default.
    """
    on_path = _path(robot, tip) if tip else None
    segments: list[_Segment] = []
    mounts = {robot.urdf.root: Mount(FIXED, np.eye(3), np.zeros(3))}
    for joint in _from_root(robot):
        if on_path is not None and joint.child not in on_path:
            continue
        mounts[joint.child] = _attach(robot, joint, mounts[joint.parent], segments)
    return _stack(segments), mounts


def build_chain(robot: Robot) -> Chain:
    """Return the chain from the base frame of `robot` to its EE frame."""
    tree, mounts = build_tree(robot, robot.ee_frame)
    end = mounts[robot.ee_frame]
    return Chain(tree, end.rotation, end.offset, len(robot.arm))


def _attach(robot: Robot, joint: Joint, mount: Mount, segments: list[_Segment]) -> Mount:
    """Return where the joint's child is mounted; a driven joint is appended to `segments`."""
    turn = Rotation.from_quat(joint.origin[3:]).as_matrix()
    rotation = mount.rotation @ turn
    offset = mount.offset + mount.rotation @ joint.origin[:3]
    if joint.kind == "fixed":
        return Mount(mount.joint, rotation, offset)
    align = _z_onto(np.asarray(joint.axis))
    drive = _drive(robot, joint)
    prismatic = joint.kind == "prismatic"
    if drive.variable == FIXED:
        motion, slide = _motion(drive.bias, prismatic)
        moved = rotation @ align
        return Mount(mount.joint, moved @ motion @ align.T, offset + moved @ slide)
    segments.append(_Segment(mount.joint, rotation @ align, offset, prismatic, drive))
    # In C order, for kernels are compiled anew for every memory layout.
    return Mount(len(segments) - 1, np.ascontiguousarray(align.T), np.zeros(3))


def _motion(position: float, prismatic: bool) -> tuple[Array, Array]:
    if prismatic:
        return np.eye(3), np.array([0.0, 0.0, position])
    return Rotation.from_rotvec([0.0, 0.0, position]).as_matrix(), np.zeros(3)


def _z_onto(axis: Array) -> Array:
    """Return a rotation matrix that takes z onto the unit vector `axis`, exact for the axes."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _drive(robot: Robot, joint: Joint) -> _Drive:
    """Return what moves `joint`."""
    names = [arm_joint.name for arm_joint in robot.arm]
    leader, multiplier, bias = robot.urdf.followed(joint)
    if leader.name in names:
        return _Drive(names.index(leader.name), multiplier, bias)
    return _Drive(FIXED, 0.0, robot.fixed_joints[joint.name])


def _from_root(robot: Robot) -> list[Joint]:
    """Return all joints, each after the one that carries it."""
    carried: dict[str, list[Joint]] = {}
    for joint in robot.urdf.joints.values():
        carried.setdefault(joint.parent, []).append(joint)
    ordered: list[Joint] = []
    links = [robot.urdf.root]
    while links:
        children = carried.get(links.pop(0), [])
        ordered += children
        links += [joint.child for joint in children]
    return ordered


def _path(robot: Robot, tip: str) -> set[str]:
    """Return the links between the root and `tip`."""
    parent = {joint.child: joint.parent for joint in robot.urdf.joints.values()}
    links = {tip}
    while tip in parent:
        tip = parent[tip]
        links.add(tip)
    return links


def _stack(segments: list[_Segment]) -> Tree:
    drives = [segment.drive for segment in segments]
    return Tree(
        parent=np.array([segment.parent for segment in segments], dtype=np.intp),
        rotation=np.array([s.rotation for s in segments]).reshape(-1, 3, 3),
        offset=np.array([s.offset for s in segments]).reshape(-1, 3),
        prismatic=np.array([s.prismatic for s in segments], dtype=np.bool_),
        variable=np.array([drive.variable for drive in drives], dtype=np.intp),
        multiplier=np.array([drive.multiplier for drive in drives], dtype=np.float64),
        bias=np.array([drive.bias for drive in drives], dtype=np.float64),
    )
