"""Collisions of robots with solids."""

import math

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.kernels import compiled, inlined, inner, kernel, square
from kinfeas.core.pose_kernels import heading
from kinfeas.core.solid_kernels import is_empty, squared_distance, squared_radius, write_prism
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.convex import BOX, CYLINDER, closer_than
from kinfeas.kinematics.forward import flattened
from kinfeas.kinematics.self_collision import (
    MARGIN,
    CollisionModel,
    CollisionScratch,
    make_collision_scratch,
    place_shapes,
)

SolidArrays = tuple[Array, Array, NDArray[np.bool_]]
"""Pose, size and cylinder of `Solids`, for kernels."""


@inlined
def write_local(pose, base, out):
    """Write the poses of solids, shape (k, 3), in the frame of a base at a world pose."""
    yaw = heading(base)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for k in range(len(pose)):
        x, y = pose[k, 0] - base[0], pose[k, 1] - base[1]
        out[k, 0], out[k, 1] = cosine * x + sine * y, cosine * y - sine * x
        out[k, 2] = pose[k, 2] - yaw


def in_base(solids: Solids, base_pose: Array) -> Solids:
    """Return n rows of solids in the frames of bases on the floor, world poses of shape (n, 7)."""
    pose, velocity = _in_base(solids.pose, solids.velocity, base_pose)
    return Solids(pose, solids.size, solids.cylinder, velocity, solids.span)


@compiled(["void(f8[:,:], f8[:,:], f8[:], f8[:,:], f8[:,:])"], "(k,p),(k,v),(b)->(k,p),(k,v)")
def _in_base(pose, velocity, base, pose_out, velocity_out):
    write_local(pose, base, pose_out)
    yaw = heading(base)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    for k in range(len(velocity)):
        x, y = velocity[k, 0], velocity[k, 1]
        velocity_out[k, 0], velocity_out[k, 1] = cosine * x + sine * y, cosine * y - sine * x


def solid_arrays(solids: Solids, n: int) -> SolidArrays:
    """Return the n rows of solids for kernels.

    Raises:
        KinfeasError: If there are not n rows.
    """
    pose, size, cylinder = solids.pose, solids.size, solids.cylinder
    if not len(pose) == len(size) == len(cylinder) == n:
        raise KinfeasError(f"solids must have {n} rows, not {len(size)}")
    return np.ascontiguousarray(pose), np.ascontiguousarray(size), np.ascontiguousarray(cylinder)


def kernel_rows(solids: Solids, base_pose: Array, n: int) -> tuple[Array, SolidArrays]:
    """Return the poses of n bases, and n rows of solids in the world, for kernels.

    Raises:
        KinfeasError: If there are not n rows of both.
    """
    if base_pose.shape != (n, 7):
        raise KinfeasError(f"base poses must be of shape ({n}, 7), not {base_pose.shape}")
    return np.ascontiguousarray(base_pose), solid_arrays(solids, n)


def collides(
    model: CollisionModel, joint_positions: Array, base_pose: Array, solids: Solids
) -> NDArray[np.bool_]:
    """Return whether shapes touch solids, to within `MARGIN`, shape (n, 2).

    The first column is of shapes that the arm does not move, the second of shapes that it moves.

    Args:
        model: Shapes of the robot.
        joint_positions: Arm joints, shape (n, v), radians or metres.
        base_pose: World poses of the bases, on the floor, shape (n, 7).
        solids: In the world, n rows.
    """
    flat, _ = flattened(model.variables, joint_positions)
    touching = np.empty((len(flat), 2), dtype=np.bool_)
    _collides_batch(model, flat, *kernel_rows(solids, base_pose, len(flat)), touching)
    return touching


def base_collides(model: CollisionModel, base_pose: Array, solids: Solids) -> NDArray[np.bool_]:
    """Return whether shapes that the arm does not move touch solids, shape (n,), as `collides`."""
    touching = np.empty(len(base_pose), dtype=np.bool_)
    _base_collides_batch(model, *kernel_rows(solids, base_pose, len(base_pose)), touching)
    return touching


@kernel
def _collides_batch(model, joint_positions, base, solids, touching):
    pose, size, cylinder = solids
    scratch, local = make_collision_scratch(model), np.empty(pose.shape[1:])
    around_base = bounds(model, False, scratch)
    for i in range(len(joint_positions)):
        place_shapes(model, joint_positions[i], scratch)
        write_local(pose[i], base[i], local)
        row = local, size[i], cylinder[i]
        touching[i, 0] = touches_solids(model, False, around_base, *row, scratch)
        touching[i, 1] = touches_solids(model, True, bounds(model, True, scratch), *row, scratch)


@kernel
def _base_collides_batch(model, base, solids, touching):
    pose, size, cylinder = solids
    scratch, local = make_collision_scratch(model), np.empty(pose.shape[1:])
    around = bounds(model, False, scratch)
    for i in range(len(base)):
        write_local(pose[i], base[i], local)
        touching[i] = touches_solids(model, False, around, local, size[i], cylinder[i], scratch)


@inner
def bounds(model: CollisionModel, moved, scratch: CollisionScratch):
    """Return the box around the shapes that the arm moves (`moved`), or around all others.

    These are least and largest x, then y and z, in the base frame, metres. The box contains the
    spheres around the shapes, grown by `MARGIN`, where `place_shapes` has put them.
    """
    back, right, low = np.inf, np.inf, np.inf
    front, left, high = -np.inf, -np.inf, -np.inf
    for s in range(len(model.body)):
        if (model.body[s] >= 0) == moved:
            x, y, z = scratch.position[s]
            radius = model.radius[s] + MARGIN
            back, front = min(back, x - radius), max(front, x + radius)
            right, left = min(right, y - radius), max(left, y + radius)
            low, high = min(low, z - radius), max(high, z + radius)
    return back, front, right, left, low, high


@inner
def touches_solids(
    model: CollisionModel, moved, around, pose, size, cylinder, scratch: CollisionScratch
):
    """Return whether a shape touches one of k solids in the base frame.

    The shapes are those that the arm moves (`moved`), or all others; `around` are their `bounds`.
    Pose, size and cylinder are a row of `Solids`.
    """
    back, front, right, left, low, high = around
    for k in range(len(pose)):
        if is_empty(size[k]) or size[k, 2] > high or size[k, 3] < low:
            continue
        x, y = pose[k, 0], pose[k, 1]
        dx, dy = max(back - x, x - front, 0.0), max(right - y, y - left, 0.0)
        if dx * dx + dy * dy > squared_radius(size[k], cylinder[k]):
            continue
        kind = _place_solid(pose[k], size[k], cylinder[k], scratch)
        for s in range(len(model.body)):
            if (model.body[s] >= 0) == moved and _touches(model, s, kind, scratch):
                return True
    return False


@inlined
def _touches(model, s, kind, scratch):
    rotation, centre, half = scratch.solid[:3], scratch.solid[3], scratch.solid[4]
    x, y, z = scratch.position[s]
    if squared_distance(scratch.prism, x, y, z) > square(model.radius[s] + MARGIN):
        return False
    return closer_than(
        MARGIN,
        model.kind[s], model.size[s], scratch.rotation[s], scratch.position[s],
        kind, half, rotation, centre,
        scratch.simplex,
    )  # fmt: skip


@inlined
def _place_solid(pose, size, cylinder, scratch):
    """Write a solid as a prism, and orientation, centre and half extents; return its kind."""
    prism, out = scratch.prism, scratch.solid
    write_prism(pose, size, cylinder, prism)
    out[0, 0], out[0, 1], out[0, 2] = prism[0], -prism[1], 0.0
    out[1, 0], out[1, 1], out[1, 2] = prism[1], prism[0], 0.0
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0
    out[3, 0], out[3, 1], out[3, 2] = pose[0], pose[1], 0.5 * (size[2] + size[3])
    out[4, 0], out[4, 1], out[4, 2] = size[0], size[1], 0.5 * (size[3] - size[2])
    return CYLINDER if cylinder else BOX
