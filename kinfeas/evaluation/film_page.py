"""An episode in the PyBullet world as a page that stands alone, by viser: everything that moved."""

from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from kinfeas.errors import KinfeasError
from kinfeas.evaluation.physics_film import Film
from kinfeas.evaluation.physics_recording import PhysicsRecording
from kinfeas.evaluation.pictures import BASE, DESIRED, EE, FAILURE, GOAL
from kinfeas.sim.camera import Solid, link_poses, show_moment, solids
from kinfeas.spatial import Array

_MOST = 600  # moments that are shown at most
_STILL = 1e-4  # m, and of a quaternion, below which nothing has moved
_WALL = 4.0  # m; what is as long hides the room
_LINE, _DASH = 3.0, 0.04
_FLOOR = (240, 242, 245)


def film_html(film: Film) -> str:
    """Return the page of an episode, with a slider for its time; the mouse turns the view.

    Args:
        film: What is shown; its framing says from where the page looks at first.

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
        server: Any = viser.ViserServer("127.0.0.1", 0, film.title, verbose=False)
    try:
        _draw_paths(server, film.recording)
        frames = _draw_solids(server, film)
        server.initial_camera.position = film.framing.eye[0]
        server.initial_camera.look_at = film.framing.target[0]
        return _play(server, film, frames)
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _play(server: Any, film: Film, frames: dict[tuple[int, int], Any]) -> str:
    recording, links = film.recording, list(frames)
    last = len(recording.moments) - 1
    moments = np.unique(np.linspace(0, last, min(_MOST, last + 1)).round().astype(int))
    recorder = server.get_scene_serializer()
    before = np.full((len(links), 7), np.inf)
    ends = np.append(recording.times[moments[1:]], recording.times[-1] + 1.0)
    for moment, end in zip(moments, ends, strict=True):
        show_moment(film.physics, recording.moments[moment])
        poses = link_poses(film.physics, links)
        for row in np.flatnonzero(np.abs(poses - before).max(axis=1) > _STILL):
            frame = frames[links[row]]
            frame.position, frame.wxyz = poses[row, :3], np.roll(poses[row, 3:], 1)
            before[row] = poses[row]
        recorder.insert_sleep(float(end - recording.times[moment]))
    html: str = recorder.as_html()
    return html


def _draw_solids(server: Any, film: Film) -> dict[tuple[int, int], Any]:
    """Draw all primitives in the frames of their links; return these by body and link."""
    frames: dict[tuple[int, int], Any] = {}
    for number, solid in enumerate(solids(film.physics)):
        if solid.kind == "box" and max(solid.size) > _WALL:
            continue
        key = (solid.body, solid.link)
        name = f"/world/{solid.body}-{solid.link + 1}"
        if key not in frames:
            frames[key] = server.scene.add_frame(name, show_axes=False)
        _draw_solid(server.scene, f"{name}/{number}", solid)
    return frames


def _draw_solid(scene: Any, name: str, solid: Solid) -> None:
    colour = tuple(round(255.0 * part) for part in solid.colour)
    placed = {"position": solid.pose[:3], "wxyz": np.roll(solid.pose[3:], 1), "color": colour}
    if solid.kind == "box":
        scene.add_box(name, dimensions=solid.size, **placed)
    elif solid.kind == "cylinder":
        scene.add_cylinder(name, radius=solid.size[0], height=solid.size[1], **placed)
    else:
        scene.add_icosphere(name, radius=solid.size[0], **placed)


def _draw_paths(server: Any, recording: PhysicsRecording) -> None:
    floor = recording.base + np.array([0.0, 0.0, 0.01])
    points = np.concatenate([floor, recording.desired, recording.goals])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2.0, high - low + 3.0
    middle[2] = 0.0
    server.scene.add_grid(
        "/floor", size[0], size[1], cell_size=0.5, plane_color=_FLOOR, plane_opacity=1,
        position=middle,
    )  # fmt: skip
    for name, path, colour in (
        ("base", floor, BASE), ("desired", recording.desired, DESIRED), ("ee", recording.ee, EE)
    ):  # fmt: skip
        if len(lines := _segments(path)):
            server.scene.add_line_segments(f"/paths/{name}", lines, _rgb(colour), line_width=_LINE)
    for number, goal in enumerate(recording.goals):
        server.scene.add_icosphere(f"/goals/{number}", 0.025, color=_rgb(GOAL), position=goal)
    failed = recording.desired[recording.failures > 0]
    if len(failed):
        server.scene.add_point_cloud("/failures", failed, _rgb(FAILURE), point_size=0.025)


def _segments(path: Array) -> Array:
    """Return a path as pieces of about two centimetres, shape (k, 2, 3)."""
    kept = [0]
    for index in range(1, len(path)):
        if np.linalg.norm(path[index] - path[kept[-1]]) >= _DASH / 2.0:
            kept.append(index)
    corners = path[kept]
    return np.stack([corners[:-1], corners[1:]], axis=1)


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(round(255.0 * part) for part in to_rgb(colour))
