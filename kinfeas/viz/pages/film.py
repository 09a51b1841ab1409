"""An episode in the PyBullet world as a page that stands alone, by viser: everything that moved."""

from typing import Any

import numpy as np

from kinfeas.backends.pybullet.camera import Solid, link_poses, show_moment, solids
from kinfeas.viz.pages.viser_server import Paths, draw_paths, rgb, serving, wxyz
from kinfeas.viz.physics.film import Film
from kinfeas.viz.pictures.style import failures_text

_MOST = 600  # moments that are shown at most
_STILL = 1e-4  # m, and of a quaternion, below which nothing has moved
_ABOVE = np.array([0.0, 0.0, 0.15])  # m, of the last goal
_WALL = 4.0  # m; what is as long hides the room


def film_html(film: Film) -> str:
    """Return the page of an episode, with a slider for its time; the mouse turns the view.

    Args:
        film: What is shown; its framing says from where the page looks at first.

    Raises:
        KinfeasError: If viser is not installed.
    """
    recording = film.recording
    failures = recording.desired[recording.failures > 0]
    paths = Paths(recording.base, recording.desired, recording.ee, recording.goals, failures)
    with serving(film.title) as server:
        draw_paths(server, paths)
        frames = _draw_solids(server, film)
        server.initial_camera.position = film.framing.eye[0]
        server.initial_camera.look_at = film.framing.target[0]
        return _play(server, film, frames)


def _play(server: Any, film: Film, frames: dict[tuple[int, int], Any]) -> str:
    recording, links = film.recording, list(frames)
    last = len(recording.moments) - 1
    moments = np.unique(np.linspace(0, last, min(_MOST, last + 1)).round().astype(int))
    recorder = server.get_scene_serializer()
    outcome = label(server, film)
    before = np.full((len(links), 7), np.inf)
    ends = np.append(recording.times[moments[1:]], recording.times[-1] + 1.0)
    for moment, end in zip(moments, ends, strict=True):
        show_moment(film.physics, recording.moments[moment])
        poses = link_poses(film.physics, links)
        for row in np.flatnonzero(np.abs(poses - before).max(axis=1) > _STILL):
            frame = frames[links[row]]
            frame.position, frame.wxyz = poses[row, :3], wxyz(poses[row])
            before[row] = poses[row]
        outcome.visible = bool(moment == last)
        recorder.insert_sleep(float(end - recording.times[moment]))
    html: str = recorder.as_html()
    return html


def label(server: Any, film: Film) -> Any:
    """Return a label above the last goal that says what the episode came to."""
    recording, failures = film.recording, int(film.recording.failures.sum())
    times = failures_text(failures)
    place = recording.goals[-1] + _ABOVE
    return server.scene.add_label("/outcome", f"{times}, {recording.outcome}", position=place)


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
    placed = {"position": solid.pose[:3], "wxyz": wxyz(solid.pose), "color": rgb(solid.colour)}
    if solid.kind == "box":
        scene.add_box(name, dimensions=solid.size, **placed)
    elif solid.kind == "cylinder":
        scene.add_cylinder(name, radius=solid.size[0], height=solid.size[1], **placed)
    else:
        scene.add_icosphere(name, radius=solid.size[0], **placed)
