"""What all pages share that viser makes: a server, and the paths of an episode."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.viz.pictures.style import BASE, DESIRED, EE, FAILURE, GOAL

_FLOOR = (245, 246, 248)
_AROUND = 1.5  # m, of floor beyond the paths
_LINE, _PIECE = 3.0, 0.02  # width in points, and length of the pieces in metres
_ABOVE = np.array([0.0, 0.0, 0.01])  # m; lines in the floor would be hidden by it


@dataclass(frozen=True, eq=False)
class Paths:
    """World positions of an episode, metres.

    Attributes:
        base: Of the base, shape (t, 3).
        desired: Where the EE should have been, shape (t, 3).
        ee: Where it was, shape (t, 3).
        goals: At the ends of the sub-goals, shape (sub-goals, 3).
        failures: Where IK found no solution, shape (k, 3).
    """

    base: Array
    desired: Array
    ee: Array
    goals: Array
    failures: Array


def start_server(title: str, port: int = 0) -> Any:
    """Return a viser server on this machine, at any free port by default; `stop_server` ends it.

    Raises:
        KinfeasError: If viser is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise KinfeasError(
            "viser is not installed, which pages need: pip install 'kinfeas[view]'"
        ) from error
    with redirect_stdout(StringIO()):  # viser prints a banner, `verbose` or not
        return viser.ViserServer("127.0.0.1", port, title, verbose=False)


def stop_server(server: Any) -> None:
    """End a server."""
    with redirect_stdout(StringIO()):
        server.stop()


@contextmanager
def serving(title: str) -> Iterator[Any]:
    """Yield a server, and end it.

    Raises:
        KinfeasError: If viser is not installed.
    """
    server = start_server(title)
    try:
        yield server
    finally:
        stop_server(server)


def draw_paths(server: Any, paths: Paths) -> tuple[Array, float]:
    """Draw an episode's paths over a floor; return the floor's middle, shape (3,), and its size."""
    points = np.concatenate([paths.base, paths.desired, paths.ee, paths.goals])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2.0, high - low + 2.0 * _AROUND
    middle[2] = 0.0
    show = server.scene
    show.add_grid(
        "/floor", size[0], size[1], cell_size=0.5, plane_color=_FLOOR, plane_opacity=1,
        position=middle,
    )  # fmt: skip
    for name, path, colour in (
        ("base", paths.base + _ABOVE, BASE), ("desired", paths.desired, DESIRED),
        ("ee", paths.ee, EE),
    ):  # fmt: skip
        if len(lines := _pieces(path)):
            show.add_line_segments(
                f"/paths/{name}", lines, rgb(colour), thickness=_LINE, thickness_units="screen"
            )
    for number, goal in enumerate(paths.goals):
        show.add_icosphere(f"/goals/{number}", 0.025, color=rgb(GOAL), position=goal)
    if len(paths.failures):
        show.add_point_cloud("/failures", paths.failures, rgb(FAILURE), point_size=0.025)
    return middle, float(size.max())


def rgb(colour: str | Sequence[float]) -> tuple[int, ...]:
    """Return a colour, by name or as shares of 1, as three numbers up to 255."""
    shares = to_rgb(colour) if isinstance(colour, str) else colour
    return tuple(round(255.0 * share) for share in shares)


def wxyz(pose: Array) -> Array:
    """Return the orientation of a pose, shape (7,), as viser has it, shape (4,)."""
    return np.roll(pose[3:], 1)


def _pieces(path: Array) -> Array:
    """Return a path, shape (t, 3), as straight pieces, shape (k, 2, 3)."""
    kept = [0]
    for index in range(1, len(path)):
        if np.linalg.norm(path[index] - path[kept[-1]]) >= _PIECE:
            kept.append(index)
    corners = path[kept]
    return np.stack([corners[:-1], corners[1:]], axis=1)
