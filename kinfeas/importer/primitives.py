"""Primitives that hold a mesh: what a collision check can be quick with."""

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from kinfeas.core.spatial import Array, compose, make_pose, rotation
from kinfeas.robots.urdf import Shape, ShapeKind

MARGIN = 5e-4
"""Metres by which primitives are too large at each side, for they are written in few digits."""

_CORNERS = 256  # that say how a primitive lies, at most; all of them say how large it is
_THIN = 1e-3  # m, of which nothing is thinner
_TURNS = [
    make_pose(np.zeros(3), Rotation.from_euler(axis, angle, degrees=True))
    for axis, angle in (("x", 0.0), ("x", 90.0), ("y", 90.0))
]
"""Which lay the z axis along each of the three."""

_CUTS = 2  # halvings at most, which make four primitives
_WORTH = 0.7  # of the volume that halves may have together, if they are to take the whole's place


def fit_primitives(triangles: Array) -> tuple[Shape, ...]:
    """Return one to four primitives that together hold a mesh.

    A mesh is cut across where its halves take much less room in primitives of their own.

    Args:
        triangles: Corners of the mesh, shape (t, 3, 3), metres, t at least 1.
    """
    return tuple(_cut(triangles, _smallest(triangles.reshape(-1, 3)), _CUTS))


def volume(shape: Shape) -> float:
    """Return the volume of a primitive, cubic metres."""
    if shape.kind == "box":
        return float(np.prod(shape.size))
    if shape.kind == "cylinder":
        return float(np.pi * shape.size[0] ** 2 * shape.size[1])
    return float(4.0 / 3.0 * np.pi * shape.size[0] ** 3)


def _cut(triangles: Array, whole: Shape, cuts: int) -> list[Shape]:
    """Return primitives for a mesh that `whole` holds, cut `cuts` times at most."""
    if cuts == 0:
        return [whole]
    choices = [_halves(triangles, whole, axis) for axis in range(3)]
    halves = [
        [(half, _smallest(half.reshape(-1, 3))) for half in choice]
        for choice in choices
        if all(map(len, choice))
    ]
    best = min(halves, key=lambda parts: sum(volume(shape) for _, shape in parts), default=[])
    if not best or sum(volume(shape) for _, shape in best) > _WORTH * volume(whole):
        return [whole]
    return [found for half, shape in best for found in _cut(half, shape, cuts - 1)]


def _halves(triangles: Array, whole: Shape, axis: int) -> list[Array]:
    """Return what lies on either side of the plane across the middle of the mesh."""
    from trimesh.intersections import slice_faces_plane

    normal = rotation(whole.pose).as_matrix()[:, axis]
    along = triangles @ normal
    origin = (along.min() + along.max()) / 2.0 * normal
    corners, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    sides = []
    for way in (1.0, -1.0):
        points, kept, *_ = slice_faces_plane(corners, faces, way * normal, origin)
        sides.append(points[kept])
    return sides


def _smallest(points: Array) -> Shape:
    """Return the smallest primitive around `points`, shape (n, 3): all are centred in the box."""
    corners = _hull(points)
    box = _box_pose(corners[:: len(corners) // _CORNERS + 1])
    upright = [compose(box, turn) for turn in _TURNS]
    found = [
        _around(corners, "box", box),
        _around(corners, "sphere", box),
        *(_around(corners, "cylinder", pose) for pose in upright),
    ]
    return min(found, key=volume)


def _around(corners: Array, kind: ShapeKind, pose: Array) -> Shape:
    """Return the primitive of a kind that stands at `pose` and holds `corners`, a little larger."""
    inner = np.abs(_seen_from(pose, corners))
    x, y, z = (inner.max(axis=0) + MARGIN).tolist()
    size: tuple[float, ...] = (2.0 * x, 2.0 * y, 2.0 * z)
    if kind == "cylinder":
        size = (float(np.hypot(inner[:, 0], inner[:, 1]).max()) + MARGIN, 2.0 * z)
    if kind == "sphere":
        size = (float(np.linalg.norm(inner, axis=1).max()) + MARGIN,)
    return Shape(kind, size, pose)


def _seen_from(pose: Array, points: Array) -> Array:
    """Return points, shape (n, 3), in the frame that stands at `pose`."""
    inner: Array = rotation(pose).inv().apply(points - pose[:3])
    return inner


def _box_pose(corners: Array) -> Array:
    """Return the pose of the smallest box around points, shape (7,)."""
    from trimesh.bounds import oriented_bounds

    to_box, _ = oriented_bounds(corners)
    matrix = np.linalg.inv(to_box)
    return make_pose(matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]))


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points, which are given a thickness if they lack it.

    What is flat, a line or a point has no hull otherwise.
    """
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=len(points) < 3)
    for axis in axes:
        along = (points - middle) @ axis
        if np.ptp(along) < _THIN:
            points = np.concatenate([points - _THIN / 2.0 * axis, points + _THIN / 2.0 * axis])
    return points[ConvexHull(points).vertices]
