"""One moment of an episode in the analytic world as an image, for films and environments."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.viz.pictures.projection import Painted, View, draw_floor, draw_solids, look
from kinfeas.viz.pictures.solids import robot_faces
from kinfeas.viz.pictures.style import ARM, BASE, BODY, DESIRED, EE, FAILURE, GOAL, INK, STYLE

SIZE = (480, 360)
_DPI = 100
_ELEVATION, _TURN = np.deg2rad(28.0), np.deg2rad(12.0)
_AROUND, _HEIGHT = 0.7, 1.6  # m, of what is seen beyond the paths, and above the floor


@dataclass(frozen=True, eq=False)
class Camera:
    """A view and the part of it that is seen: lower left and upper right corner, shape (2, 2)."""

    view: View
    corners: Array


def watch(base: Array, goal: Array, points: Array) -> Camera:
    """Return a camera beside the way from `base` to `goal` that sees `points` and a robot there.

    Args:
        base: Where the robot starts, world position, shape (3,), metres.
        goal: Where the EE is to go, shape (3,).
        points: What is to be seen, too, shape (k, 3).
    """
    way = goal[:2] - base[:2]
    view = look(float(np.arctan2(way[1], way[0]) + _TURN), float(_ELEVATION))
    around = np.concatenate([points, base[np.newaxis], goal[np.newaxis]])
    low, high = around.min(axis=0) - _AROUND, around.max(axis=0) + _AROUND
    low[2], high[2] = 0.0, max(high[2] - _AROUND, _HEIGHT)
    box = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
                    for z in (low[2], high[2])])  # fmt: skip
    flat = view.flat(box)
    middle, half = (flat.min(axis=0) + flat.max(axis=0)) / 2.0, np.ptp(flat, axis=0) / 2.0
    width, height = SIZE
    half = np.maximum(half, half[::-1] * [width / height, height / width])
    return Camera(view, np.stack([middle - half, middle + half]))


def moment_image(
    robot: Robot,
    posture: tuple[Array, Array],
    paths: tuple[Array, Array, Array],
    goals: Array,
    camera: Camera,
    failures: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Return an image, shape (360, 480, 3): the robot, its paths and the goals.

    Args:
        robot: Who is seen.
        posture: World pose of its base, shape (7,), and arm joints, shape (j,).
        paths: World positions until now of base, achieved and desired EE, shapes (t, 3); metres.
        goals: World positions, shape (k, 3).
        camera: From where.
        failures: Whether IK failed, shape (t,); nowhere by default.
    """
    view, (low, high) = camera.view, camera.corners
    faces = [
        Painted(face.corners, ARM if face.arm else BODY) for face in robot_faces(robot, *posture)
    ]
    base, ee, desired = (view.flat(path) for path in paths)
    with rc_context(STYLE):
        figure = Figure(figsize=(SIZE[0] / _DPI, SIZE[1] / _DPI), dpi=_DPI)
        canvas: Any = FigureCanvasAgg(figure)  # whose methods have no types
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        draw_floor(axes, view, np.concatenate((goals, *paths)))
        draw_solids(axes, view, faces)
        axes.plot(*base.T, color=BASE, lw=1.8, zorder=2.8)
        axes.plot(*ee.T, color=EE, lw=2.0, zorder=7)
        axes.plot(*desired.T, color=DESIRED, lw=1.0, ls=(0, (4, 3)), zorder=8)
        if failures is not None:
            axes.plot(*ee[failures].T, "o", color=FAILURE, ms=4.0, mew=0.0, zorder=12)
        axes.plot(*view.flat(goals).T, "*", color=GOAL, mec=INK, mew=0.7, ms=14.0, zorder=11)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_axis_off()
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
