"""Robots, scenes and episodes in 3-D pages, made by viser; saved pages need no server."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.backend import LinkName
from kinfeas.core.spatial import Array
from kinfeas.scenes.objects import free_joints
from kinfeas.scenes.scene import Scene
from kinfeas.viz.replay import EpisodeReplay, Recording, result
from kinfeas.viz.server import serving
from kinfeas.viz.shapes import (
    VisualShape,
    corners,
    far_end,
    scene_poses,
    scene_shapes,
    scene_solids,
    surrounding,
)
from kinfeas.viz.style import BASE, DESIRED, EE, FAILURE, GOAL, failures_text

_SKY, _FLOOR, _LINES = (232, 236, 241), (214, 218, 224), (188, 194, 202)  # colours
_VIEW = np.array([0.82, -1.18, 0.85])  # to the camera, by the radius of the content
_STILL = 1e-4  # m, and of a quaternion


def draw_floor(
    server: Any, size: Sequence[float], cell: float, position: Sequence[float] = (0.0, 0.0, 0.0)
) -> Any:
    """Draw a sky and a floor of a size (2,) with a grid; return the handle of the floor."""
    server.scene.set_background_image(np.full((1, 1, 3), _SKY, dtype=np.uint8), "png")
    return server.scene.add_grid(
        "/floor", size[0], size[1], cell_size=cell, cell_color=_LINES, section_color=_LINES,
        plane_color=_FLOOR, plane_opacity=1, position=position,
    )  # fmt: skip


def aim(server: Any, points: Array) -> None:
    """Put the camera of a page where it shows all points, shape (k, 3), in metres."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2.0, max(0.5, float(np.linalg.norm(high - low)) / 2.0)
    server.initial_camera.position = middle + radius * _VIEW
    server.initial_camera.look_at = middle


def draw(server: Any, name: str, visual: VisualShape) -> Any:
    """Draw a shape; return its handle."""
    _, shape, colour = visual
    red, green, blue, *alpha = rgb(colour)
    how: dict[str, Any] = {"position": shape.pose[:3], "wxyz": np.roll(shape.pose[3:], 1)}
    how |= {"color": (red, green, blue), "opacity": alpha[0] / 255.0 if alpha else None}
    if shape.kind == "box":
        return server.scene.add_box(name, dimensions=shape.size, **how)
    if shape.kind == "cylinder":
        radius, height = shape.size
        return server.scene.add_cylinder(name, radius=radius, height=height, **how)
    return server.scene.add_icosphere(name, radius=shape.size[0], **how)


def place(drawn: Any, pose: Array) -> None:
    """Move a drawn object to a pose (7,), if that is a visible change."""
    wxyz = np.roll(pose[3:], 1)
    if max(np.abs(drawn.position - pose[:3]).max(), np.abs(drawn.wxyz - wxyz).max()) > _STILL:
        drawn.position, drawn.wxyz = pose[:3], wxyz  # each change is a message in the page


def rgb(colour: str) -> tuple[int, ...]:
    """Return a colour, `#rrggbb` or `#rrggbbaa`, in the range of viser, 0 to 255."""
    return tuple(bytes.fromhex(colour.removeprefix("#")))


class Bodies:
    """Shapes in a page that move with their links."""

    def __init__(self, server: Any, name: str, shapes: Sequence[VisualShape]) -> None:
        """Draw shapes below the node `name`."""
        self._root = server.scene.add_frame(name, show_axes=False)
        self._frames: dict[LinkName, Any] = {}
        for number, visual in enumerate(shapes):
            if visual.link not in self._frames:
                path = f"{name}/{len(self._frames)}"
                self._frames[visual.link] = server.scene.add_frame(path, show_axes=False)
            draw(server, f"{self._frames[visual.link].name}/{number}", visual)

    def move(self, poses: Mapping[LinkName, Array]) -> None:
        """Move the links to their world poses (7,)."""
        for link, frame in self._frames.items():
            place(frame, poses[link])

    def remove(self) -> None:
        """Remove the shapes from the page."""
        self._root.remove()


_AROUND = 1.5  # m, of floor beyond the paths
_PIECE = 0.02  # m, length of the pieces of a path
_SCENE_FRAMES, _SCENE_RATE = 90, 30.0
_RATE, _MOST = 15.0, 1200  # moments of an episode per second, and largest number


def scene_html(scene: Scene) -> str:
    """Return a page of a scene on which all joints open and close."""
    joints = {
        (name, joint.name): (at := entry.joint_positions[joint.name], far_end(joint, at))
        for name, entry in scene.objects.items()
        for joint in free_joints(entry.urdf).values()
    }
    with serving(f"kinfeas: {scene.name}") as server:
        around = surrounding(scene)
        content = [solid for solid in scene_solids(scene) if solid.link[0] not in around]
        aim(server, corners(content) if content else np.array([[*scene.size, 0.0], [0.0] * 3]))
        draw_floor(server, scene.size, 1.0)
        bodies = Bodies(server, "/scene", scene_shapes(scene))
        bodies.move(scene_poses(scene))
        film = server.get_scene_serializer()
        for frame in range(_SCENE_FRAMES if joints else 0):
            fraction = 0.5 - 0.5 * np.cos(2.0 * np.pi * frame / _SCENE_FRAMES)
            objects: dict[str, dict[str, float]] = {}
            for (name, joint), (at, end) in joints.items():
                objects.setdefault(name, {})[joint] = at + fraction * (end - at)
            bodies.move(scene_poses(scene.with_joints(objects)))
            film.insert_sleep(1.0 / _SCENE_RATE)
        return server.titled(film.as_html())


def moments(times: Array) -> NDArray[np.intp]:
    """Return indices of the moments to show, at most 15 per second, with the last one."""
    seconds = float(times[-1] - times[0])
    count = int(np.clip(np.ceil(seconds * _RATE), 1, min(_MOST, len(times))))
    moment_times = np.linspace(times[0], times[-1], count)
    return np.unique(np.append(np.searchsorted(times, moment_times), len(times) - 1))


def replay_html(replay: EpisodeReplay) -> str:
    """Return the page of an episode, on which everything moves as it did."""
    recording, times = replay.recording, replay.recording.times
    with serving(f"kinfeas: {replay.title}") as server:
        _draw_paths(server, recording)
        bodies = Bodies(server, "/bodies", replay.shapes)
        text = f"{failures_text(int(np.sum(~recording.feasible)))}, {result(recording)[0]}"
        position = recording.goal[:3] + np.array([0.0, 0.0, 0.15])
        label = server.scene.add_label("/result", text, position=position, visible=False)
        film, shown_moments = server.get_scene_serializer(), moments(times).tolist()
        for moment, after in zip(
            shown_moments, [*shown_moments[1:], shown_moments[-1]], strict=True
        ):
            bodies.move(replay.links(moment))
            label.visible = moment == shown_moments[-1]
            film.insert_sleep(max(float(times[after] - times[moment]), 1.0 / _RATE))
        return server.titled(film.as_html())


def _draw_paths(server: Any, recording: Recording) -> None:
    base = recording.base_pose[:, :3] + np.array([0.0, 0.0, 0.01])
    desired, goals = recording.desired[:, :3], recording.goals[:, :3]
    paths = {BASE: base, DESIRED: desired, EE: recording.ee_pose[:, :3]}
    points = np.concatenate([*paths.values(), goals])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2.0 * [1.0, 1.0, 0.0], high - low + 2.0 * _AROUND
    draw_floor(server, size, 0.5, middle)
    for colour, path in paths.items():
        travelled = np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))
        _, kept = np.unique((travelled / _PIECE).astype(int), return_index=True)
        ends = path[np.concatenate([[0], kept + 1])]
        if len(kept):
            server.scene.add_line_segments(
                f"/paths/{colour[1:]}", np.stack([ends[:-1], ends[1:]], axis=1), rgb(colour),
                thickness=3.0, thickness_units="screen",
            )  # fmt: skip
    for number, goal in enumerate(goals):
        server.scene.add_icosphere(f"/goals/{number}", 0.025, color=rgb(GOAL), position=goal)
    failures = desired[~recording.feasible]
    if len(failures):
        server.scene.add_point_cloud("/failures", failures, rgb(FAILURE), point_size=0.025)
    away = np.array([1.8, -2.6, 2.0]) * max(1.0, float(size.max()) / 4.0)
    server.initial_camera.position = middle + away
    server.initial_camera.look_at = middle + np.array([0.0, 0.0, 0.5])
