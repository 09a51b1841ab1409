"""Forward kinematics: the chain as arrays for kernels, EE poses and the Jacobian."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinfeas.core.errors import KinfeasError
from kinfeas.core.kernels import inlined, kernel
from kinfeas.core.pose_kernels import product
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.robots.urdf import Joint

FIXED = -1


class Tree(NamedTuple):
    """The m moving joints of a robot, each after its parent.

    Every joint rotates about or slides along the z axis of its own frame: the constant transforms
    before and after it contain the rotation to the URDF's axis. Its motion thus changes only two
    columns of a rotation matrix. The v variables are the positions of the arm's joints.
    """

    parent: NDArray[np.intp]  # parent joint, shape (m,); -1 is the robot's base
    rotation: Array  # orientation of the joint in the parent's body, shape (m, 3, 3)
    offset: Array  # position of the joint in the parent's body, shape (m, 3), metres
    prismatic: NDArray[np.bool_]  # whether the joint is prismatic, shape (m,)
    variable: NDArray[np.intp]  # index of the variable that drives the joint, shape (m,)
    multiplier: Array  # joint position per unit of the variable, shape (m,); 1 unless mimic
    bias: Array  # joint position where the variable is 0, shape (m,)


class Mount(NamedTuple):
    """Pose of a link on the body that a joint moves."""

    joint: int  # index into the tree; -1 is the robot's base
    rotation: Array  # orientation of the link in that body, shape (3, 3)
    offset: Array  # position of the link in that body, shape (3,), metres


class Chain(NamedTuple):
    """A serial tree (parent of i is i - 1) with the EE frame on its last body."""

    tree: Tree  # joints from the base to the EE
    ee_rotation: Array  # orientation of the EE frame in the last body, shape (3, 3)
    ee_offset: Array  # position of the EE frame in the last body, shape (3,), metres
    variables: int  # number of the arm's joints, including those that do not move the EE


_Segment = tuple[int, Array, Array, bool, int, float, float]  # fields of a `Tree` for one joint


def build_tree(robot: Robot, tip: str | None = None) -> tuple[Tree, dict[str, Mount]]:
    """Return the tree of joints that the arm drives, and the mount of each link by name.

    With `tip`, only joints and links from the root to this link are included. All other joints are
    at `robot.fixed_joints`.
    """
    urdf = robot.urdf
    on_path = {joint.child for joint in urdf.path_to(tip)} if tip else set(urdf.links)
    segments: list[_Segment] = []
    mounts = {urdf.root: Mount(FIXED, np.eye(3), np.zeros(3))}
    links = [urdf.root]
    for link in links:
        for joint in urdf.on[link]:
            if joint.child in on_path:
                mounts[joint.child] = _attach(robot, joint, mounts[link], segments)
                links.append(joint.child)
    columns = zip(*segments, strict=True) if segments else [()] * len(Tree._fields)
    parent, rotations, offsets, prismatic, variable, multiplier, bias = columns
    tree = Tree(
        parent=np.array(parent, dtype=np.intp),
        rotation=np.array(rotations).reshape(-1, 3, 3),
        offset=np.array(offsets).reshape(-1, 3),
        prismatic=np.array(prismatic, dtype=np.bool_),
        variable=np.array(variable, dtype=np.intp),
        multiplier=np.array(multiplier, dtype=np.float64),
        bias=np.array(bias, dtype=np.float64),
    )
    return tree, mounts


def build_chain(robot: Robot) -> Chain:
    """Return the chain from the base frame of `robot` to its EE frame."""
    tree, mounts = build_tree(robot, robot.ee_frame)
    end = mounts[robot.ee_frame]
    return Chain(tree, end.rotation, end.offset, len(robot.arm))


def _attach(robot: Robot, joint: Joint, mount: Mount, segments: list[_Segment]) -> Mount:
    """Return the mount of the joint's child; add the joint to `segments` if the arm drives it."""
    rotation = mount.rotation @ Rotation.from_quat(joint.origin[3:]).as_matrix()
    offset = mount.offset + mount.rotation @ joint.origin[:3]
    if joint.kind == "fixed":
        return Mount(mount.joint, rotation, offset)
    align, prismatic = _z_onto(np.asarray(joint.axis)), joint.kind == "prismatic"
    leader, multiplier, bias = robot.urdf.followed(joint)
    names = [arm_joint.name for arm_joint in robot.arm]
    if leader.name not in names:
        position = robot.fixed_joints[joint.name]
        motion = Rotation.from_rotvec([0.0, 0.0, 0.0 if prismatic else position]).as_matrix()
        slide = np.array([0.0, 0.0, position if prismatic else 0.0])
        moved = rotation @ align
        return Mount(mount.joint, moved @ motion @ align.T, offset + moved @ slide)
    drive = names.index(leader.name), multiplier, bias
    segments.append((mount.joint, rotation @ align, offset, prismatic, *drive))
    # In C order, since kernels are compiled for each memory layout.
    return Mount(len(segments) - 1, np.ascontiguousarray(align.T), np.zeros(3))


def _z_onto(axis: Array) -> Array:
    """Return a rotation matrix from z to the unit vector `axis`, exact for coordinate axes."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def forward(chain: Chain, joint_positions: Array) -> Array:
    """Return the EE pose in the base frame, (..., 7), at joint positions (..., v), rad or m."""
    flat, leading = flattened(chain.variables, joint_positions)
    poses = np.empty((len(flat), 7))
    _forward_batch(chain, flat, poses)
    return poses.reshape(*leading, 7)


def jacobian(chain: Chain, joint_positions: Array) -> Array:
    """Return the Jacobian of the EE at joint positions (..., v), rad or m, shape (..., 6, v).

    Rows are linear, then angular, in the axes of the base frame, at the EE origin.
    """
    flat, leading = flattened(chain.variables, joint_positions)
    columns = np.empty((*flat.shape, 6))
    _jacobian_batch(chain, flat, columns)
    return columns.swapaxes(1, 2).reshape(*leading, 6, chain.variables)


def flattened(variables: int, joint_positions: Array) -> tuple[Array, tuple[int, ...]]:
    """Return joint positions (..., v) as an array for kernels, (n, v), and their leading shape."""
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
    """Frames of a chain, allocated once for a whole batch."""

    motion: Array  # cosine, sine and translation of each joint, shape (m, 3)
    axis: Array  # joint axes in the base frame, shape (m, 3)
    origin: Array  # joint origins in the base frame, shape (m, 3), metres
    rotation: Array  # EE orientation in the base frame, shape (3, 3)
    position: Array  # EE position in the base frame, shape (3,), metres


@kernel
def make_frames(joints):
    """Return empty frames for a chain of `joints` joints."""
    return Frames(
        np.empty((joints, 3)), np.empty((joints, 3)), np.empty((joints, 3)), np.empty((3, 3)),
        np.empty(3),
    )  # fmt: skip


@inlined
def place_joints(tree: Tree, q, motion):
    """Write cosine, sine and translation of every joint, (m, 3), at the variables `q`, (v,)."""
    for i in range(len(tree.variable)):
        value = tree.multiplier[i] * q[tree.variable[i]] + tree.bias[i]
        if tree.prismatic[i]:
            motion[i, 0], motion[i, 1], motion[i, 2] = 1.0, 0.0, value
        else:
            motion[i, 0], motion[i, 1], motion[i, 2] = math.cos(value), math.sin(value), 0.0


@inlined
def place_chain(chain: Chain, q, frames):
    """Write axes, origins and EE pose of the chain at the variables `q`, shape (v,)."""
    tree, motion, rotation, position = chain.tree, frames.motion, frames.rotation, frames.position
    place_joints(tree, q, motion)
    for r in range(3):
        for k in range(3):
            rotation[r, k] = 1.0 if r == k else 0.0
        position[r] = 0.0
    for i in range(len(tree.variable)):
        for r in range(3):
            a, b, c = rotation[r, 0], rotation[r, 1], rotation[r, 2]
            position[r] += a * tree.offset[i, 0] + b * tree.offset[i, 1] + c * tree.offset[i, 2]
            a, b, c = turn_row(a, b, c, tree.rotation[i], motion[i, 0], motion[i, 1])
            position[r] += c * motion[i, 2]
            rotation[r, 0], rotation[r, 1], rotation[r, 2] = a, b, c
            frames.axis[i, r], frames.origin[i, r] = c, position[r]
    offset = chain.ee_offset
    for r in range(3):
        a, b, c = rotation[r, 0], rotation[r, 1], rotation[r, 2]
        position[r] += a * offset[0] + b * offset[1] + c * offset[2]
        a, b, c = turn_row(a, b, c, chain.ee_rotation, 1.0, 0.0)
        rotation[r, 0], rotation[r, 1], rotation[r, 2] = a, b, c


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


@inlined
def write_matrix(pose, out):
    """Write the orientation of a pose, shape (7,), as a matrix, shape (3, 3)."""
    x, y, z, w = pose[3], pose[4], pose[5], pose[6]
    s = 2.0 / (x * x + y * y + z * z + w * w)
    out[0, 0], out[1, 1] = 1.0 - s * (y * y + z * z), 1.0 - s * (x * x + z * z)
    out[2, 2] = 1.0 - s * (x * x + y * y)
    out[0, 1], out[1, 0] = s * (x * y - z * w), s * (x * y + z * w)
    out[0, 2], out[2, 0] = s * (x * z + y * w), s * (x * z - y * w)
    out[1, 2], out[2, 1] = s * (y * z - x * w), s * (y * z + x * w)


@inlined
def write_pose(position, matrix, out):
    """Write a position, shape (3,), and a rotation matrix, shape (3, 3), as a pose, shape (7,).

    The largest component comes from the diagonal, the others from quotients by it (Shepperd, J.
    Guidance and Control 1978).
    """
    a, b, c = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    if a + b + c > 0.0:
        w = 1.0 + a + b + c
        x, y = matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0]
        z = matrix[1, 0] - matrix[0, 1]
    elif a >= b and a >= c:
        x, w = 1.0 + a - b - c, matrix[2, 1] - matrix[1, 2]
        y, z = matrix[0, 1] + matrix[1, 0], matrix[0, 2] + matrix[2, 0]
    elif b >= c:
        y, w = 1.0 + b - a - c, matrix[0, 2] - matrix[2, 0]
        x, z = matrix[0, 1] + matrix[1, 0], matrix[1, 2] + matrix[2, 1]
    else:
        z, w = 1.0 + c - a - b, matrix[1, 0] - matrix[0, 1]
        x, y = matrix[0, 2] + matrix[2, 0], matrix[1, 2] + matrix[2, 1]
    for i in range(3):
        out[i] = position[i]
    out[3], out[4], out[5], out[6] = product(x, y, z, w, 0.0, 0.0, 0.0, 1.0)
