"""Nearest points of solids to the base of a robot, for the obstacle filter."""

import math

import numpy as np

from kinfeas.core.backend import ObstacleDistances
from kinfeas.core.pose_kernels import heading
from kinfeas.core.solid_kernels import PRISM, is_empty, outward, squared_radius, write_prism
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.convex import CYLINDER, SPHERE
from kinfeas.kinematics.kernels import copy_row, inner, kernel, square
from kinfeas.kinematics.self_collision import MARGIN, CollisionModel
from kinfeas.kinematics.solids import surroundings, write_local

AS_NEAR = 0.1
"""Distance beyond that of the nearest point of a solid within which others are reported, metres."""

_PLACES = 64
"""Places for the points of a row at first; a row with more needs a second pass."""


def base_obstacles(
    prisms: Array, base_pose: Array, solids: Solids, within: float
) -> ObstacleDistances:
    """Return the solids nearer than `within` metres to the shapes that the arm does not move.

    Tilted shapes count as the upright boxes around them. Of each solid, all pairs of a corner and
    an opposite side are reported that are at most 0.1 m farther apart than its nearest point: with
    one point of a side that is parallel to a wall, a base could rotate about it into the wall.

    Args:
        prisms: Shapes of the robot, from `base_prisms`.
        base_pose: World poses of the bases, on the floor, shape (n, 7).
        solids: In the world, n rows.
        within: Metres.
    """
    n, used = len(base_pose), _PLACES
    base, rows = surroundings(solids, base_pose, n)
    velocity = np.ascontiguousarray(solids.velocity)
    while True:
        found = np.zeros((n, used, 6))
        found[:, :, 4] = np.inf
        if (needed := _obstacles_batch(prisms, base, rows, velocity, within, found)) <= used:
            break
        used = needed
    found = found[:, :needed]
    return ObstacleDistances(found[..., :2], found[..., 2:4], found[..., 4], found[..., 5])


def base_prisms(model: CollisionModel) -> Array:
    """Return prisms around the shapes on the base, shape (s, `PRISM`), in the base frame."""
    fixed = model.body < 0
    half, turn, kind = model.size[fixed], model.rotation[fixed], model.kind[fixed]
    high = np.where(kind == SPHERE, half[:, 0], (np.abs(turn[:, 2]) * half).sum(axis=1))
    rounded = (kind == SPHERE) | ((kind == CYLINDER) & (np.abs(turn[:, 2, 2]) > 1.0 - 1e-9))
    axes = turn[:, :2] * half[:, np.newaxis]
    lengths = np.linalg.norm(axes, axis=1)
    longest = lengths.argmax(axis=1)[:, np.newaxis]
    along = np.take_along_axis(axes, longest[:, np.newaxis], axis=2)[:, :, 0]
    along /= np.take_along_axis(lengths, longest, axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    prisms = np.empty((len(half), PRISM))
    prisms[:, :2], prisms[:, 2:4] = along, model.offset[fixed, :2]
    for column, side in ((4, along), (5, across)):
        extent = np.abs(np.einsum("si,sij->sj", side, axes)).sum(axis=1)
        prisms[:, column] = np.where(rounded, 0.0, extent)
    prisms[:, 6] = np.where(rounded, half[:, 0], 0.0)
    prisms[:, 9] = np.sqrt(np.square(prisms[:, 4:6]).sum(axis=1)) + prisms[:, 6]
    prisms[:, 7], prisms[:, 8] = model.offset[fixed, 2] - high, model.offset[fixed, 2] + high
    prisms[:, 7:9] += [-MARGIN, MARGIN]
    return prisms


@kernel
def _obstacles_batch(prisms, base, rows, velocity, within, out):
    """Write points, normals, distances and closing speeds, shape (n, p, 6).

    Returns the largest number of a row.
    """
    pose, size, cylinder = rows
    local, most, reach = np.empty(pose.shape[1:]), 0, 0.0
    for s in range(len(prisms)):
        one = prisms[s]
        reach = max(reach, math.sqrt(square(one[2]) + square(one[3])) + one[9])
    pairs = np.empty((8 * len(prisms), 6))
    solid = np.empty(PRISM)
    for i in range(len(base)):
        write_local(pose[i], base[i], local)
        solids = local, size[i], cylinder[i], velocity[i], heading(base[i])
        most = max(most, _obstacles(prisms, reach, solids, within, pairs, solid, out[i]))
    return most


@inner
def _obstacles(prisms, reach, solids, within, pairs, solid, out):
    """Write points, normals, distances and closing speeds of a row, shape (p, 6).

    `reach` is the radius of the circle around the robot's shapes, metres; `solids` are in the base
    frame, with their world velocity and the yaw of the base; `pairs`, shape (8 s, 6), and `solid`,
    (`PRISM`,), are scratch memory. Returns the number of points.
    """
    pose, size, cylinder, velocity, yaw = solids
    cosine, sine, used = math.cos(yaw), math.sin(yaw), 0
    for k in range(len(pose)):
        farthest = reach + within + math.sqrt(squared_radius(size[k], cylinder[k]))
        squared = square(pose[k, 0]) + square(pose[k, 1])
        if is_empty(size[k]) or squared > square(farthest):
            continue
        write_prism(pose[k], size[k], cylinder[k], solid)
        count, nearest = 0, within
        for s in range(len(prisms)):
            one = prisms[s]
            if one[7] >= solid[8] or solid[7] >= one[8]:
                continue
            gap, x, y = outward(solid, one[2], one[3])
            along, across = one[0] * x + one[1] * y, one[0] * y - one[1] * x
            extent = abs(along) * one[4] + abs(across) * one[5] + one[6] + solid[6]
            if gap - extent > nearest + AS_NEAR:  # a side of the solid separates them
                continue
            first = count
            count = _pair_corners(one, solid, 1.0, pairs, count)
            count = _pair_corners(solid, one, -1.0, pairs, count)
            for p in range(first, count):
                nearest = min(nearest, pairs[p, 4])
        for p in range(count):
            if pairs[p, 4] < within and pairs[p, 4] <= nearest + AS_NEAR:
                if used < out.shape[0]:
                    copy_row(pairs[p], out[used])
                    ahead = cosine * velocity[k, 0] + sine * velocity[k, 1]
                    left = cosine * velocity[k, 1] - sine * velocity[k, 0]
                    out[used, 5] = -(ahead * pairs[p, 2] + left * pairs[p, 3])
                used += 1
    return used


@inner
def _pair_corners(one, other, sign, pairs, count):
    """Add the corners of one prism with their nearest points of another; return the new count.

    The sign is 1 if the first prism is the robot's, else -1.
    """
    corners = 4 if one[4] > 0.0 else 1
    for corner in range(corners):
        u = one[4] if corner % 2 == 0 else -one[4]
        v = one[5] if corner < 2 else -one[5]
        x, y = one[2] + one[0] * u - one[1] * v, one[3] + one[1] * u + one[0] * v
        gap, normal_x, normal_y = outward(other, x, y)
        normal_x, normal_y = -sign * normal_x, -sign * normal_y
        way = one[6] if sign > 0.0 else other[6] - gap
        pairs[count, 0], pairs[count, 1] = x + way * normal_x, y + way * normal_y
        pairs[count, 2], pairs[count, 3] = normal_x, normal_y
        pairs[count, 4] = gap - one[6] - other[6]
        count += 1
    return count
