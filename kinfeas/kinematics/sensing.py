"""Measurements of the solids around bases: range scans and nearest points."""

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

from kinfeas.core.backend import SCAN_BANDS, SCAN_BEAMS, SCAN_RANGE, ObstacleDistances
from kinfeas.core.kernels import copy_row, inlined, inner, kernel, square
from kinfeas.core.pose_kernels import heading
from kinfeas.core.solid_kernels import PRISM, is_empty, outward, squared_radius, write_prism
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.convex import BOX, CYLINDER, SPHERE
from kinfeas.kinematics.self_collision import MARGIN, CollisionModel
from kinfeas.kinematics.solids import kernel_rows, write_local

AS_NEAR = 0.1
"""Points of a solid that are at most this much farther than its nearest are reported, metres."""

_SLICE, _SIDES = 0.05, 16
"""Largest height of a slice, metres; numbers of sides of a round outline and of directions in which
rectangles are tried."""

_POINTS = 64
"""Points of a row for which there is memory at first; a row with more needs a second pass."""


def scan(
    solids: Solids | None,
    base_pose: Array,
    bands: tuple[tuple[float, float], ...] = SCAN_BANDS,
    beams: int = SCAN_BEAMS,
    max_range: float = SCAN_RANGE,
) -> Array:
    """Return ranges around the bases in b bands of height, shape (n, b, beams), metres.

    Beam i has the angle -pi + 2 pi i / `beams` to the base's heading and begins at the origin of
    the base frame. Its range is the distance to the first solid that is at least partly within the
    band, 0 inside such a solid, and `max_range` if there is none.

    Args:
        solids: In the world, n rows, or None.
        base_pose: World poses of the bases, on the floor, shape (n, 7).
        bands: Lowest and highest z of each band, metres.
        beams: Number of beams.
        max_range: Longest range, metres.
    """
    ranges = np.full((len(base_pose), len(bands), beams), float(max_range))
    if solids is not None:
        angles = -np.pi + 2.0 * np.pi / beams * np.arange(beams)
        rays = np.array(bands).reshape(-1, 2), np.cos(angles), np.sin(angles)
        base, rows = kernel_rows(solids, base_pose, len(ranges))
        _scan_batch(base, rows, *rays, float(max_range), ranges)
    return ranges


@kernel
def _scan_batch(base, solids, bands, cosine, sine, max_range, ranges):
    pose, size, cylinder = solids
    local, prism = np.empty(pose.shape[1:]), np.empty(PRISM)
    for i in range(len(base)):
        write_local(pose[i], base[i], local)
        for k in range(len(local)):
            if not is_empty(size[i, k]):
                write_prism(local[k], size[i, k], cylinder[i, k], prism)
                _scan(prism, bands, cosine, sine, max_range, ranges[i])


@inlined
def _scan(prism, bands, cosine, sine, max_range, ranges):
    """Shorten the ranges of one row, shape (b, beams), that end at a solid."""
    axis_x, axis_y, x, y, radius = prism[0], prism[1], prism[2], prism[3], prism[9]
    squared, beams = x * x + y * y, ranges.shape[1]
    if squared >= square(max_range + radius):
        return
    # The beams that pass through the circle around the solid; rounding may add one at each side.
    first, last = 0, beams - 1
    if squared > square(radius):
        middle = math.atan2(y, x) + np.pi
        half = math.asin(radius / math.sqrt(squared)) + 1e-9
        per_beam = beams / (2.0 * np.pi)
        first, last = math.ceil((middle - half) * per_beam), math.floor((middle + half) * per_beam)
    u, v = axis_x * x + axis_y * y, axis_x * y - axis_y * x
    for number in range(first, last + 1):
        j = number % beams
        if prism[6] > 0.0:
            length = _until_circle(x, y, square(prism[6]), cosine[j], sine[j])
        else:
            along = axis_x * cosine[j] + axis_y * sine[j]
            across = axis_x * sine[j] - axis_y * cosine[j]
            length = _until_rectangle(u, v, prism[4:6], along, across)
        for b in range(len(bands)):
            if prism[7] < bands[b, 1] and prism[8] > bands[b, 0]:
                ranges[b, j] = min(ranges[b, j], length)


@inlined
def _until_circle(x, y, squared_radius, cosine, sine):
    """Return the length of a ray from the origin to a circle around (x, y); inf if it misses."""
    along, aside = x * cosine + y * sine, y * cosine - x * sine
    if x * x + y * y <= squared_radius:
        return 0.0
    if along <= 0.0 or aside * aside > squared_radius:
        return np.inf
    return along - math.sqrt(squared_radius - aside * aside)


@inlined
def _until_rectangle(x, y, half, cosine, sine):
    """Return the length of a ray from the origin to a rectangle around (x, y) along the axes."""
    enter, leave = 0.0, np.inf
    for centre, extent, slope in ((x, half[0], cosine), (y, half[1], sine)):
        if abs(slope) > 1e-12:
            near, far = (centre - extent) / slope, (centre + extent) / slope
            enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
        elif abs(centre) > extent:
            return np.inf
    return enter if enter <= leave else np.inf


def base_obstacles(
    prisms: Array, base_pose: Array, solids: Solids, within: float
) -> ObstacleDistances:
    """Return the solids nearer than `within` metres to the shapes that the arm does not move.

    Tilted shapes count as the upright boxes around them. For each solid, all pairs of a corner and
    an opposite side are reported that are at most 0.1 m farther apart than the nearest pair: if a
    side parallel to a wall had one point only, a base could rotate about it into the wall.

    Args:
        prisms: Shapes of the robot, from `base_prisms`.
        base_pose: World poses of the bases, on the floor, shape (n, 7).
        solids: In the world, n rows.
        within: Largest distance, metres.
    """
    n, room = len(base_pose), _POINTS
    base, rows = kernel_rows(solids, base_pose, n)
    velocity = np.ascontiguousarray(solids.velocity)
    while True:
        points = np.zeros((n, room, 6))
        points[:, :, 4] = np.inf
        if (used := _obstacles_batch(prisms, base, rows, velocity, within, points)) <= room:
            break
        room = used
    points = points[:, :used]
    return ObstacleDistances(points[..., :2], points[..., 2:4], points[..., 4], points[..., 5])


def base_prisms(model: CollisionModel) -> Array:
    """Return prisms around the shapes on the base, shape (s, `PRISM`), in the base frame."""
    fixed = model.body < 0
    half, rotation, kind = model.size[fixed], model.rotation[fixed], model.kind[fixed]
    high = np.where(kind == SPHERE, half[:, 0], (np.abs(rotation[:, 2]) * half).sum(axis=1))
    rounded = (kind == SPHERE) | ((kind == CYLINDER) & (np.abs(rotation[:, 2, 2]) > 1.0 - 1e-9))
    axes = rotation[:, :2] * half[:, np.newaxis]
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


def fine_base_prisms(model: CollisionModel, meshes: Iterable[Array] = ()) -> Array:
    """Return `base_prisms` with tilted shapes and meshes cut into slices, which fit more closely.

    Slices are horizontal. `meshes` are vertices in the base frame, shape (v, 3) each, metres; their
    convex hulls count as shapes on the base.
    """
    tilted = (np.abs(model.rotation[:, 2]).max(axis=1) < 1.0 - 1e-9) & (model.kind != SPHERE)
    angle = 2.0 * np.pi / _SIDES * (np.arange(_SIDES) + 0.5)
    circle = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / _SIDES)
    outlines = {BOX: np.sign(circle[1::4]), CYLINDER: circle}
    hulls = list(meshes)
    for s in np.flatnonzero(tilted & (model.body < 0)):
        outline = outlines[int(model.kind[s])]
        corners = np.array([[*corner, end] for corner in outline for end in (-1.0, 1.0)])
        hulls.append(corners * model.size[s] @ model.rotation[s].T + model.offset[s])
    whole = base_prisms(model._replace(body=np.where(tilted, 0, model.body)))
    return np.concatenate([whole, *map(_slices, hulls)])


def _slices(points: Array) -> Array:
    """Return prisms around slices of the convex hull of points (v, 3), shape (s, `PRISM`)."""
    points = points[ConvexHull(points, qhull_options="QJ").vertices]
    first, second = (points[ends] for ends in np.triu_indices(len(points), 1))
    low, high = points[:, 2].min(), points[:, 2].max()
    prisms = []
    slices = max(math.ceil((high - low) / _SLICE), 1)  # one slice of a flat mesh
    for bottom, top in pairwise(np.linspace(low, high, 1 + slices)):
        parts = [points[(points[:, 2] >= bottom) & (points[:, 2] <= top)]]
        for height in (bottom, top):
            cut = (first[:, 2] < height) != (second[:, 2] < height)
            start, end = first[cut], second[cut]
            fraction = (height - start[:, 2:]) / (end - start)[:, 2:]
            parts.append(start + fraction * (end - start))
        prisms.append(_prism_around(np.concatenate(parts)[:, :2], bottom - MARGIN, top + MARGIN))
    return np.array(prisms)


def _prism_around(points: Array, low: float, high: float) -> list[float]:
    """Return the smaller of a box and a cylinder around points (v, 2), metres, as a prism."""
    angle = np.linspace(0.0, 0.5 * np.pi, _SIDES, endpoint=False)
    along = np.stack([np.cos(angle), np.sin(angle)])
    across = np.stack([-along[1], along[0]])
    sides = np.stack([points @ along, points @ across])  # (2, v, a)
    least, most = sides.min(axis=1), sides.max(axis=1)
    best = (most - least).prod(axis=0).argmin()
    middle, half = (least + most)[:, best] / 2.0, (most - least)[:, best] / 2.0
    centre = middle[0] * along[:, best] + middle[1] * across[:, best]
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    if np.pi * radius * radius < 4.0 * half.prod():
        return [1.0, 0.0, *centre, 0.0, 0.0, radius, low, high, radius]
    return [*along[:, best], *centre, *half, 0.0, low, high, math.hypot(*half)]


@kernel
def _obstacles_batch(prisms, base, rows, velocity, within, out):
    """Write points, normals, distances and closing speeds, shape (n, p, 6).

    Returns the largest number of points of a row.
    """
    pose, size, cylinder = rows
    local, most, reach = np.empty(pose.shape[1:]), 0, 0.0
    for s in range(len(prisms)):
        reach = max(reach, math.hypot(prisms[s, 2], prisms[s, 3]) + prisms[s, 9])
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
            own = prisms[s]
            if own[7] >= solid[8] or solid[7] >= own[8]:
                continue
            gap, x, y = outward(solid, own[2], own[3])
            along, across = own[0] * x + own[1] * y, own[0] * y - own[1] * x
            extent = abs(along) * own[4] + abs(across) * own[5] + own[6] + solid[6]
            if gap - extent > nearest + AS_NEAR:  # apart along the solid's normal
                continue
            first = count
            count = _pair_corners(own, solid, 1.0, pairs, count)
            count = _pair_corners(solid, own, -1.0, pairs, count)
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
def _pair_corners(prism, other, sign, pairs, count):
    """Add pairs of a corner of `prism` and its nearest point of `other`; return the new count.

    The sign is 1 if `prism` is the robot's, -1 if it is the solid's.
    """
    corners = 4 if prism[4] > 0.0 else 1
    for corner in range(corners):
        u = prism[4] if corner % 2 == 0 else -prism[4]
        v = prism[5] if corner < 2 else -prism[5]
        x, y = prism[2] + prism[0] * u - prism[1] * v, prism[3] + prism[1] * u + prism[0] * v
        gap, normal_x, normal_y = outward(other, x, y)
        normal_x, normal_y = -sign * normal_x, -sign * normal_y
        shift = prism[6] if sign > 0.0 else other[6] - gap
        pairs[count, 0], pairs[count, 1] = x + shift * normal_x, y + shift * normal_y
        pairs[count, 2], pairs[count, 3] = normal_x, normal_y
        pairs[count, 4] = gap - prism[6] - other[6]
        count += 1
    return count
