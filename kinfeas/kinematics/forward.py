"""Batched forward kinematics and Jacobian."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.kinematics.kernels import inlined, kernel, write_pose
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


def forward(chain: Chain, joint_positions: Array) -> Array:
    """Return the EE pose in the base frame.

    Args:
        chain: The robot's chain with v variables.
        joint_positions: Shape (..., v), radians or metres.

    Returns:
        Poses, shape (..., 7).

    Raises:
        KinfeasError: If the joint positions are of another shape.
    """
    flat, leading = flattened(chain.variables, joint_positions)
    poses = np.empty((len(flat), 7))
    _forward_batch(chain, flat, poses)
    return poses.reshape(*leading, 7)


def jacobian(chain: Chain, joint_positions: Array) -> Array:
    """Return the derivative of the EE's twist by the joints' velocities.

    Args:
        chain: The robot's chain with v variables.
        joint_positions: Shape (..., v), radians or metres.

    Returns:
        Shape (..., 6, v): linear rows, then angular rows, along the base's axes, at the EE origin.

    Raises:
        KinfeasError: If the joint positions are of another shape.
    """
    flat, leading = flattened(chain.variables, joint_positions)
    columns = np.empty((*flat.shape, 6))
    _jacobian_batch(chain, flat, columns)
    return columns.swapaxes(1, 2).reshape(*leading, 6, chain.variables)


def flattened(variables: int, joint_positions: Array) -> tuple[Array, tuple[int, ...]]:
    """Return configurations as the kernels take them, shape (n, v), and their leading axes.

    Args:
        variables: How many the arm has, v.
        joint_positions: Shape (..., v), radians or metres.

    Raises:
        KinfeasError: If the last axis is of another length: the kernels do not look.
    """
    rows = np.ascontiguousarray(joint_positions, dtype=np.float64)
    if rows.shape[-1] != variables:
        raise KinfeasError(f"joint positions must be of shape (..., {variables}), not {rows.shape}")
    return rows.reshape(-1, variables), rows.shape[:-1]


@kernel
def _forward_batch(chain, joint_positions, poses):
    frames = make_frames(len(chain.tree.variable))
    for i in range(len(joint_positions)):
        place_chain(chain, joint_positions[i], frames)
        write_pose(frames.position, frames.rotation, poses[i])


@kernel
def _jacobian_batch(chain, joint_positions, out):
    frames = make_frames(len(chain.tree.variable))
    for i in range(len(joint_positions)):
        place_chain(chain, joint_positions[i], frames)
        fill_columns(chain.tree, frames, out[i])


class Frames(NamedTuple):
    """Where a chain is, and memory to get there; allocated once for a whole batch.

    Attributes:
        motion: Cosine, sine and slide of each joint, shape (m, 3).
        axis: Joint axes in the base frame, shape (m, 3).
        origin: Joint origins in the base frame, shape (m, 3), metres.
        rotation: EE orientation in the base frame, shape (3, 3).
        position: EE position in the base frame, shape (3,), metres.
    """

    motion: Array
    axis: Array
    origin: Array
    rotation: Array
    position: Array


@inlined
def make_frames(joints):
    """Return memory for a chain of `joints` joints."""
    return Frames(
        np.empty((joints, 3)),
        np.empty((joints, 3)),
        np.empty((joints, 3)),
        np.empty((3, 3)),
        np.empty(3),
    )


@inlined
def place_joints(tree: Tree, q, motion):
    """Write cosine, sine and slide of every joint, shape (m, 3), for the variables `q`, (v,)."""
    for i in range(len(tree.variable)):
        value = tree.multiplier[i] * q[tree.variable[i]] + tree.bias[i]
        if tree.prismatic[i]:
            motion[i, 0], motion[i, 1], motion[i, 2] = 1.0, 0.0, value
        else:
            motion[i, 0], motion[i, 1], motion[i, 2] = math.cos(value), math.sin(value), 0.0


@inlined
def place_chain(chain: Chain, q, frames):
    """Write axes, origins and EE pose of the chain at the variables `q`, shape (v,).

    A row of a product of rotations depends on the same row of its first factor alone, so that the
    chain is walked three times with three numbers in hand.
    """
    tree, motion = chain.tree, frames.motion
    place_joints(tree, q, motion)
    turn, offset = chain.ee_rotation, chain.ee_offset
    for r in range(3):
        a, b, c = 1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0
        place = 0.0
        for i in range(len(tree.variable)):
            place += a * tree.offset[i, 0] + b * tree.offset[i, 1] + c * tree.offset[i, 2]
            a, b, c = turn_row(a, b, c, tree.rotation[i], motion[i, 0], motion[i, 1])
            place += c * motion[i, 2]
            frames.axis[i, r], frames.origin[i, r] = c, place
        frames.position[r] = place + a * offset[0] + b * offset[1] + c * offset[2]
        a, b, c = turn_row(a, b, c, turn, 1.0, 0.0)
        frames.rotation[r, 0], frames.rotation[r, 1], frames.rotation[r, 2] = a, b, c


@inlined
def turn_row(a, b, c, constant, cosine, sine):
    """Return the row (a, b, c) times a constant rotation (3, 3), then turned about z."""
    x = a * constant[0, 0] + b * constant[1, 0] + c * constant[2, 0]
    y = a * constant[0, 1] + b * constant[1, 1] + c * constant[2, 1]
    z = a * constant[0, 2] + b * constant[1, 2] + c * constant[2, 2]
    return x * cosine + y * sine, y * cosine - x * sine, z


@inlined
def fill_columns(tree: Tree, frames: Frames, out):
    """Write the columns (v, 6) of the EE's Jacobian."""
    out[:] = 0.0
    for i in range(len(tree.variable)):
        j, scale = tree.variable[i], tree.multiplier[i]
        zx, zy, zz = frames.axis[i, 0] * scale, frames.axis[i, 1] * scale, frames.axis[i, 2] * scale
        if tree.prismatic[i]:
            out[j, 0] += zx
            out[j, 1] += zy
            out[j, 2] += zz
        else:
            x = frames.position[0] - frames.origin[i, 0]
            y = frames.position[1] - frames.origin[i, 1]
            z = frames.position[2] - frames.origin[i, 2]
            out[j, 0] += zy * z - zz * y
            out[j, 1] += zz * x - zx * z
            out[j, 2] += zx * y - zy * x
            out[j, 3] += zx
            out[j, 4] += zy
            out[j, 5] += zz
