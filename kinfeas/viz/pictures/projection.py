"""Solids and lines seen from a corner, drawn on flat axes: parallel lines stay parallel."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb

from kinfeas.core.spatial import Array

_LIGHT = np.array([0.35, -0.5, 0.8]) / np.linalg.norm([0.35, -0.5, 0.8])
"""Where the light comes from, along the screen's right, into it, and up."""

_DARKEST = 0.55

_MOST_CELLS = 2000
"""More cells of the floor's grid, one way, cannot be told apart."""

Colour = str | tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class View:
    """A direction to look from.

    Attributes:
        right: World direction that points to the right of the picture, unit, shape (3,).
        up: Same, to its top.
        toward: Same, to the viewer.
    """

    right: Array
    up: Array
    toward: Array

    def flat(self, points: Array) -> Array:
        """Return where world points, shape (..., 3), come to lie, shape (..., 2), metres."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


def look(heading: float, elevation: float) -> View:
    """Return the view in which the world direction `heading` points to the right.

    Args:
        heading: Radians from the world's x axis.
        elevation: Angle from which to look down, radians; 0 is a side view, pi/2 a top view.
    """
    right = np.array([np.cos(heading), np.sin(heading), 0.0])
    level = np.array([right[1], -right[0], 0.0])
    toward = np.cos(elevation) * level + np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    return View(right, np.cross(toward, right), toward)


@dataclass(frozen=True, eq=False)
class Painted:
    """A flat polygon with its colour.

    Attributes:
        corners: Shape (k, 3), metres, counter-clockwise when seen from outside.
        colour: Any that matplotlib knows.
    """

    corners: Array
    colour: Colour


def show_to_scale(axes: Axes) -> None:
    """End a view of solids on a floor: all of it, to scale, with a word on the floor's grid."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.set_axis_off()
    axes.annotate(
        "floor grid: 0.5 m", (0.0, 0.0), xycoords="axes fraction", fontsize=8.5, color="#7b828c"
    )


def draw_solids(axes: Axes, view: View, faces: Iterable[Painted]) -> None:
    """Draw the faces that look toward the viewer, the nearer ones over those behind them."""
    seen = [
        (face, normal) for face in faces if (normal := normal_of(face.corners)) @ view.toward > 1e-6
    ]
    seen.sort(key=lambda item: _nearness(item[0], view))
    colours = [shade(face.colour, light_on(normal, view)) for face, normal in seen]
    axes.add_collection(
        PolyCollection(
            [view.flat(face.corners) for face, _ in seen],
            facecolors=colours,
            edgecolors=[tuple(0.8 * part for part in colour) for colour in colours],
            linewidths=0.25,
            zorder=3,
        )
    )


def draw_floor(axes: Axes, view: View, points: Array, cell: float = 0.5) -> None:
    """Draw a grid, along the view, on the floor below `points`, shape (k, 3), metres.

    None is drawn where it would be too fine to see.
    """
    along = view.right
    across = np.array([-along[1], along[0], 0.0])
    seen = points @ np.stack([along, across], axis=1)
    low = np.floor((seen.min(axis=0) - 0.1) / cell) * cell
    high = np.ceil((seen.max(axis=0) + 0.1) / cell) * cell
    if np.max(high - low) > _MOST_CELLS * cell:
        return
    xs, ys = (np.arange(a, b + cell / 2.0, cell) for a, b in zip(low, high, strict=True))
    ends = [((x, low[1]), (x, high[1])) for x in xs] + [((low[0], y), (high[0], y)) for y in ys]
    lines = [view.flat(np.array(pair) @ np.stack([along, across])) for pair in ends]
    axes.add_collection(LineCollection(lines, colors="#e3e6ea", linewidths=0.7, zorder=1))


def _nearness(face: Painted, view: View) -> float:
    """Return what orders faces from back to front: the middle alone misjudges long ones."""
    depth = face.corners @ view.toward
    return float(np.max(depth) + np.mean(depth))


def normal_of(corners: Array) -> Array:
    """Return the unit vector out of a flat polygon, whose corners are (k, 3), shape (3,)."""
    a, b, c = corners[:3]
    normal = np.cross(b - a, c - a)
    return normal / max(float(np.linalg.norm(normal)), 1e-12)


def light_on(normal: Array, view: View) -> float:
    """Return how squarely the light falls on a face, in [-1, 1]; it comes with the viewer."""
    light = _LIGHT @ np.array([view.right, -view.toward, view.up])
    return float(normal @ light)


def shade(colour: Colour, light: float) -> tuple[float, float, float]:
    """Return a colour in a light that falls on it as `light_on` says."""
    brightness = _DARKEST + (1.0 - _DARKEST) * (0.5 + 0.5 * light)
    red, green, blue = (min(1.0, brightness * part) for part in to_rgb(colour))
    return red, green, blue
