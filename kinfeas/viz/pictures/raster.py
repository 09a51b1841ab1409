"""Solids as an image: each pixel shows what is nearest to the viewer, however things interlock."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from kinfeas.core.spatial import Array
from kinfeas.viz.pictures.projection import Painted, View, light_on, normal_of, shade

_FINER = 2  # pixels in each direction that are averaged into one
_EDGE = 0.72  # how dark an edge is beside its faces
_STEP = 0.02  # m, of depth that makes an edge


@dataclass(frozen=True, eq=False)
class _Canvas:
    """Pixels with their centres (u, v) in metres and what each one shows."""

    u: Array
    v: Array
    colour: Array
    depth: Array
    normal: Array


def paint_solids(
    axes: Axes, view: View, faces: Iterable[Painted], metres_per_pixel: float = 0.005
) -> None:
    """Draw the faces that look toward the viewer as an image in the metres of `axes`."""
    seen = [face for face in faces if normal_of(face.corners) @ view.toward > 1e-6]
    if not seen:
        return
    points = view.flat(np.concatenate([face.corners for face in seen]))
    margin = 4.0 * metres_per_pixel
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    width, height = np.ceil((high - low) / metres_per_pixel).astype(int)
    pixel = metres_per_pixel / _FINER
    canvas = _canvas(low, (height * _FINER, width * _FINER), pixel)
    for face in seen:
        _fill(canvas, view, face)
    image = _with_edges(canvas).reshape(height, _FINER, width, _FINER, 4)
    weight = image[..., 3:].sum(axis=(1, 3))
    colour = (image[..., :3] * image[..., 3:]).sum(axis=(1, 3)) / np.maximum(weight, 1e-9)
    extent = (low[0], low[0] + width * metres_per_pixel, low[1], low[1] + height * metres_per_pixel)
    axes.imshow(
        np.concatenate([colour, weight / _FINER**2], axis=-1), origin="lower", extent=extent,
        zorder=3, interpolation="antialiased",
    )  # fmt: skip


def _canvas(low: Array, size: tuple[int, int], pixel: float) -> _Canvas:
    rows, columns = size
    return _Canvas(
        low[0] + pixel * (np.arange(columns) + 0.5),
        low[1] + pixel * (np.arange(rows) + 0.5),
        np.zeros((rows, columns, 4)),
        np.full(size, -np.inf),
        np.zeros((rows, columns, 3)),
    )


def _fill(canvas: _Canvas, view: View, face: Painted) -> None:
    """Write a convex face wherever nothing nearer stands."""
    flat, normal = view.flat(face.corners), normal_of(face.corners)
    rows = slice(*np.searchsorted(canvas.v, [flat[:, 1].min(), flat[:, 1].max()]))
    columns = slice(*np.searchsorted(canvas.u, [flat[:, 0].min(), flat[:, 0].max()]))
    u, v = canvas.u[columns], canvas.v[rows][:, np.newaxis]
    inside = np.ones((len(v), len(u)), dtype=np.bool_)
    for (x0, y0), (x1, y1) in zip(flat, np.roll(flat, -1, axis=0), strict=True):
        inside &= (x1 - x0) * (v - y0) - (y1 - y0) * (u - x0) >= 0.0
    level = face.corners[0] @ normal
    depth = (level - (normal @ view.right) * u - (normal @ view.up) * v) / (normal @ view.toward)
    inside &= depth > canvas.depth[rows, columns]
    canvas.depth[rows, columns][inside] = depth[inside]
    canvas.normal[rows, columns][inside] = normal
    canvas.colour[rows, columns][inside] = (*shade(face.colour, light_on(normal, view)), 1.0)


def _with_edges(canvas: _Canvas) -> Array:
    """Return the colours, darker where a pixel's neighbour shows another side or what is behind."""
    edge: NDArray[np.bool_] = np.zeros(canvas.depth.shape, dtype=np.bool_)
    depth = np.where(np.isfinite(canvas.depth), canvas.depth, -1e3)
    for axis in (0, 1):
        turned = np.abs(np.diff(canvas.normal, axis=axis)).max(axis=-1) > 0.2
        # Of a face that is seen at a slant, depth changes evenly from pixel to pixel.
        bent = np.abs(np.diff(depth, n=2, axis=axis, append=depth.take([-1], axis))) > _STEP
        found = turned | bent
        near = tuple(slice(0, -1) if k == axis else slice(None) for k in (0, 1))
        edge[near] |= found
    colour = canvas.colour.copy()
    colour[edge, :3] *= _EDGE
    return colour
