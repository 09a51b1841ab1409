"""Compiled geometry behind `solids`: upright boxes and cylinders as prisms.

A prism is a row of `PRISM` numbers: cosine and sine of its yaw, x and y of its centre, its half
extents, the radius by which it is rounded, its lowest and highest z, and the radius of the circle
around it; metres. A cylinder is a rounded point.
"""

import math

import numpy as np

from kinfeas.core.kernels import compiled, copy_row, inlined

PRISM = 10


@inlined
def is_empty(size):
    """Return whether a row of `Solids.size` holds no solid."""
    return not (size[0] > 0.0 and size[1] > 0.0)


@inlined
def squared_radius(size, cylinder):
    """Return the squared radius of the circle around a solid, seen from above, m^2."""
    return size[0] * size[0] if cylinder else size[0] * size[0] + size[1] * size[1]


@inlined
def write_prism(pose, size, cylinder, out):
    """Write a row of `Solids` as a prism, shape (`PRISM`,)."""
    out[0], out[1], out[2], out[3] = math.cos(pose[2]), math.sin(pose[2]), pose[0], pose[1]
    out[4], out[5], out[6] = size[0], size[1], 0.0
    if cylinder:
        out[4], out[5], out[6] = 0.0, 0.0, size[0]
    out[7], out[8] = size[2], size[3]
    out[9] = math.sqrt(squared_radius(size, cylinder))


@inlined
def _offsets(prism, x, y):
    """Return the offsets of a position from the centre of a prism, along its axes."""
    dx, dy = x - prism[2], y - prism[3]
    return prism[0] * dx + prism[1] * dy, prism[0] * dy - prism[1] * dx


@inlined
def outward(prism, x, y):
    """Return the horizontal distance from a prism without its rounding, and the unit vector away.

    Inside, the distance is negative and both are those of the nearest side.
    """
    u, v = _offsets(prism, x, y)
    beyond_u, beyond_v = abs(u) - prism[4], abs(v) - prism[5]
    out_u, out_v = max(beyond_u, 0.0), max(beyond_v, 0.0)
    gap = math.sqrt(out_u * out_u + out_v * out_v)
    if gap > 0.0:
        out_u, out_v = out_u / gap, out_v / gap
    else:
        gap = max(beyond_u, beyond_v)
        out_u, out_v = (1.0, 0.0) if beyond_u > beyond_v else (0.0, 1.0)
    out_u, out_v = math.copysign(out_u, u), math.copysign(out_v, v)
    return gap, prism[0] * out_u - prism[1] * out_v, prism[1] * out_u + prism[0] * out_v


@inlined
def horizontal_gap(prism, x, y):
    """Return the horizontal distance from a prism, metres, negative inside."""
    u, v = _offsets(prism, x, y)
    u, v = abs(u) - prism[4], abs(v) - prism[5]
    return (math.sqrt(u * u + v * v) if u > 0.0 and v > 0.0 else max(u, v)) - prism[6]


@inlined
def vertical_gap(prism, z):
    """Return the vertical distance from a prism, metres, 0 beside it."""
    return max(max(prism[7] - z, z - prism[8]), 0.0)


@inlined
def squared_distance(prism, x, y, z):
    """Return the squared distance from a prism, m^2, 0 inside."""
    u, v = _offsets(prism, x, y)
    u, v, above = max(abs(u) - prism[4], 0.0), max(abs(v) - prism[5], 0.0), vertical_gap(prism, z)
    squared = u * u + v * v
    if prism[6] > 0.0:
        beside = max(math.sqrt(squared) - prism[6], 0.0)
        squared = beside * beside
    return squared + above * above


@compiled(
    ["void(f8[:,:], f8[:,:], f8[:,:], b1[:], f8[:,:], f8[:,:])"],
    "(m,x),(k,p),(k,s),(k)->(m,k),(m,k)",
)
def gaps(points, pose, size, cylinder, planar, vertical):
    """Horizontal and vertical gaps from points to solids; empty ones are infinitely far."""
    prism = np.empty(PRISM)
    for k in range(len(pose)):
        write_prism(pose[k], size[k], cylinder[k], prism)
        for i in range(len(points)):
            planar[i, k] = max(horizontal_gap(prism, points[i, 0], points[i, 1]), 0.0)
            vertical[i, k] = vertical_gap(prism, points[i, 2])
            if is_empty(size[k]):
                planar[i, k] = np.inf


@compiled(
    ["void(f8[:,:], f8[:,:], b1[:], f8[:,:], f8, f8, f8[:,:], f8[:,:])"],
    "(k,p),(k,s),(k),(k,v),(),()->(k,p),(k,s)",
)
def swept(pose, size, cylinder, velocity, first, last, pose_out, size_out):
    """Poses and sizes of solids that cover the motion of others between two times, seconds."""
    for k in range(len(pose)):
        copy_row(pose[k], pose_out[k])
        copy_row(size[k], size_out[k])
        cosine, sine = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        x, y = 0.5 * (last - first) * velocity[k, 0], 0.5 * (last - first) * velocity[k, 1]
        u, v = abs(cosine * x + sine * y), abs(cosine * y - sine * x)
        if cylinder[k]:
            u = v = math.sqrt(x * x + y * y)
        size_out[k, 0] += u
        size_out[k, 1] += v
        pose_out[k, 0] += 0.5 * (first + last) * velocity[k, 0]
        pose_out[k, 1] += 0.5 * (first + last) * velocity[k, 1]
