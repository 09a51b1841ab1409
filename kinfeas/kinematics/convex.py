"""Proximity test of boxes, cylinders and spheres, by GJK."""

import math

import numpy as np

from kinfeas.core.kernels import copy_row, inner, square

BOX, CYLINDER, SPHERE = 0, 1, 2
MAX_ITERATIONS = 30

SCRATCH_ROWS = 13
"""Rows of scratch memory: four points of a simplex, the point nearest to the origin, and their
copies while a tetrahedron is reduced."""


@inner
def closer_than(margin, kind_a, size_a, rot_a, pos_a, kind_b, size_b, rot_b, pos_b, simplex):
    """Return whether two shapes are closer than `margin` metres; True without convergence.

    Kinds are BOX, CYLINDER or SPHERE; sizes are half extents along the shape's axes, shape (3,): a
    cylinder is radius, radius, half length, a sphere its radius three times. Orientations have
    shape (3, 3), centres (3,), metres. `simplex` is scratch memory, shape (`SCRATCH_ROWS`, 3).
    """
    v = simplex[4]
    for i in range(3):
        v[i] = pos_a[i] - pos_b[i]
    count = 0
    for _ in range(MAX_ITERATIONS):
        length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if length < margin:
            return True
        w = simplex[count]
        w[:] = 0.0
        add_support(w, -1.0, 1.0, v, kind_a, size_a, rot_a, pos_a)
        add_support(w, 1.0, -1.0, v, kind_b, size_b, rot_b, pos_b)
        if w[0] * v[0] + w[1] * v[1] + w[2] * v[2] > margin * length:
            return False
        count = _nearest(simplex, count + 1, v)
        if count == 4:
            return True
    return True


@inner
def add_support(w, toward, sign, v, kind, size, rot, pos):
    """Add to w `sign` times the support point of a shape in the direction `toward` * v."""
    x = toward * (rot[0, 0] * v[0] + rot[1, 0] * v[1] + rot[2, 0] * v[2])
    y = toward * (rot[0, 1] * v[0] + rot[1, 1] * v[1] + rot[2, 1] * v[2])
    z = toward * (rot[0, 2] * v[0] + rot[1, 2] * v[1] + rot[2, 2] * v[2])
    if kind == BOX:
        x = math.copysign(size[0], x)
        y = math.copysign(size[1], y)
        z = math.copysign(size[2], z)
    else:
        radial = math.sqrt(x * x + y * y) if kind == CYLINDER else math.sqrt(x * x + y * y + z * z)
        scale = size[0] / radial if radial > 1e-300 else 0.0
        x, y = x * scale, y * scale
        z = math.copysign(size[2], z) if kind == CYLINDER else z * scale
    for i in range(3):
        w[i] += sign * (pos[i] + rot[i, 0] * x + rot[i, 1] * y + rot[i, 2] * z)


@inner
def _nearest(simplex, count, v):
    """Write the simplex's point nearest to the origin; reduce the simplex to the face around it.

    Returns:
        Number of points that remain; 4 if the origin is inside.
    """
    if count == 1:
        copy_row(simplex[0], v)
        return 1
    if count == 2:
        return _nearest_on_segment(simplex, v)
    if count == 3:
        return _nearest_on_triangle(simplex, v)
    return _nearest_in_tetrahedron(simplex, v)


@inner
def _nearest_on_segment(simplex, v):
    a, b = simplex[0], simplex[1]
    along, squared = 0.0, 0.0
    for i in range(3):
        edge = b[i] - a[i]
        along -= a[i] * edge
        squared += edge * edge
    if squared <= 0.0 or along <= 0.0:
        copy_row(a, v)
        return 1
    if along >= squared:
        copy_row(b, v)
        copy_row(b, a)
        return 1
    for i in range(3):
        v[i] = a[i] + (b[i] - a[i]) * (along / squared)
    return 2


@inner
def _nearest_on_triangle(simplex, v):
    """Ericson, Real-Time Collision Detection (2005), section 5.1.5, with the origin as point."""
    a, b, c = simplex[0], simplex[1], simplex[2]
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 -= ab * a[i]
        d2 -= ac * a[i]
        d3 -= ab * b[i]
        d4 -= ac * b[i]
        d5 -= ab * c[i]
        d6 -= ac * c[i]
    if d1 <= 0.0 and d2 <= 0.0:
        copy_row(a, v)
        return 1
    if d3 >= 0.0 and d4 <= d3:
        copy_row(b, v)
        copy_row(b, a)
        return 1
    if d6 >= 0.0 and d5 <= d6:
        copy_row(c, v)
        copy_row(c, a)
        return 1
    if d1 * d4 - d3 * d2 <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _nearest_on_segment(simplex, v)
    if d5 * d2 - d1 * d6 <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        copy_row(c, b)
        return _nearest_on_segment(simplex, v)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        copy_row(c, a)
        return _nearest_on_segment(simplex, v)
    vb, vc = d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    total = va + vb + vc
    if total <= 0.0:
        return _nearest_on_segment(simplex, v)
    for i in range(3):
        v[i] = a[i] + (b[i] - a[i]) * (vb / total) + (c[i] - a[i]) * (vc / total)
    return 3


@inner
def _nearest_in_tetrahedron(simplex, v):
    """Try all four faces; the one without the newest point matters only for rounding errors."""
    for i in range(4):
        copy_row(simplex[i], simplex[5 + i])
    a, b, c, d = simplex[5], simplex[6], simplex[7], simplex[8]
    kept, trial = simplex[9:12], simplex[12]
    inside, best, best_count = True, np.inf, 4
    for face in range(4):
        p = a if face != 3 else d
        q = b if face != 2 else d
        r = c if face != 1 else d
        opposite = d if face == 0 else (c if face == 1 else (b if face == 2 else a))
        if not _beyond(p, q, r, opposite):
            continue
        inside = False
        copy_row(p, simplex[0])
        copy_row(q, simplex[1])
        copy_row(r, simplex[2])
        count = _nearest_on_triangle(simplex, trial)
        squared = square(trial[0]) + square(trial[1]) + square(trial[2])
        if squared < best:
            best, best_count = squared, count
            copy_row(trial, v)
            for i in range(3):
                copy_row(simplex[i], kept[i])
    if inside:
        return 4
    for i in range(3):
        copy_row(kept[i], simplex[i])
    return best_count


@inner
def _beyond(p, q, r, opposite):
    """Return whether the plane p q r separates the origin from `opposite`."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    wx, wy, wz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    origin = -(nx * p[0] + ny * p[1] + nz * p[2])
    other = nx * (opposite[0] - p[0]) + ny * (opposite[1] - p[1]) + nz * (opposite[2] - p[2])
    return origin * other <= 0.0
