"""Batched forward kinematics and Jacobian."""

import math
from typing import NamedTuple

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.kinematics.chain import Chain, Tree
from kinfeas.kinematics.kernels import inlined, kernel
from kinfeas.kinematics.matrices import write_pose


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
