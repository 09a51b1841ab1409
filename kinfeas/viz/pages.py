"""Robots, scenes and episodes in 3-D pages, made by viser; saved pages need no server."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull

from kinfeas.backends.physics.backend import LinkName
from kinfeas.core.spatial import IDENTITY, Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.objects import free_joints
from kinfeas.scenes.scene import Scene
from kinfeas.viz.replay import EpisodeReplay, Recording, caption, shown_moments
from kinfeas.viz.server import serving
from kinfeas.viz.shapes import (
    VisualShape,
    corners,
    far_end,
    heading_from_middle,
    robot_poses,
    robot_shapes,
    robot_solids,
    scene_poses,
    scene_shapes,
    scene_solids,
    surrounding,
)
from kinfeas.viz.style import ARM, BASE, BODY, DESIRED, EE, FAILURE, GOAL

if TYPE_CHECKING:
    from kinfeas.viz.live import Episode

_SKY, _FLOOR, _LINES = (232, 236, 241), (214, 218, 224), (188, 194, 202)  # colours
_AWAY, _UP = 1.44, 0.85  # distance and height of the camera, in radii of the content
_STILL = 1e-4  # m, or of a quaternion's entry: smaller changes are not sent


def draw_floor(
    server: Any, size: Sequence[float], cell: float, position: Sequence[float] = (0.0, 0.0, 0.0)
) -> Any:
    """Draw a sky, and a floor of `size` (2,) with a grid, metres; return the floor's handle."""
    server.scene.set_background_image(np.full((1, 1, 3), _SKY, dtype=np.uint8), "png")
    return server.scene.add_grid(
        "/floor", size[0], size[1], cell_size=cell, cell_color=_LINES, section_color=_LINES,
        plane_color=_FLOOR, plane_opacity=1, position=position,
    )  # fmt: skip


def aim(server: Any, points: Array) -> None:
    """Aim the camera of a page at furniture with corners (k, 3), seen from its open side."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2.0, max(0.5, float(np.linalg.norm(high - low)) / 2.0)
    heading = heading_from_middle(points)
    view = np.array([_AWAY * np.sin(heading), -_AWAY * np.cos(heading), _UP])
    server.initial_camera.position = middle + radius * view
    server.initial_camera.look_at = middle


def draw(server: Any, name: str, visual: VisualShape) -> Any:
    """Draw a shape; return its handle."""
    _, shape, colour = visual
    red, green, blue, *alpha = rgb(colour)
    looks: dict[str, Any] = {"position": shape.pose[:3], "wxyz": np.roll(shape.pose[3:], 1)}
    looks |= {"color": (red, green, blue), "opacity": alpha[0] / 255.0 if alpha else None}
    if shape.kind == "box":
        return server.scene.add_box(name, dimensions=shape.size, **looks)
    if shape.kind == "cylinder":
        radius, height = shape.size
        return server.scene.add_cylinder(name, radius=radius, height=height, **looks)
    return server.scene.add_icosphere(name, radius=shape.size[0], **looks)


def place(drawn: Any, pose: Array) -> None:
    """Move a drawn object to a pose (7,), if that is a visible change."""
    wxyz = np.roll(pose[3:], 1)
    if max(np.abs(drawn.position - pose[:3]).max(), np.abs(drawn.wxyz - wxyz).max()) > _STILL:
        drawn.position, drawn.wxyz = pose[:3], wxyz  # each change is a message in the page


def rgb(colour: str) -> tuple[int, ...]:
    """Return the components of a colour `#rrggbb` or `#rrggbbaa`, 0 to 255."""
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


_AROUND = 1.5  # m, margin of the floor around the paths
_PIECE = 0.02  # m, length of the pieces of a path
_SCENE_FRAMES, _SCENE_RATE = 90, 30.0
_RATE, _MOST = 15.0, 1200  # shown moments of an episode per second, and in all


def scene_html(scene: Scene) -> str:
    """Return the HTML page of a scene, in which all joints open and close."""
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


def replay_html(replay: EpisodeReplay) -> str:
    """Return the HTML page of an episode, which replays all motions."""
    recording, times = replay.recording, replay.recording.times
    with serving(f"kinfeas: {replay.title}") as server:
        _draw_paths(server, recording)
        bodies = Bodies(server, "/bodies", replay.shapes)
        position = recording.goal[:3] + np.array([0.0, 0.0, 0.15])
        label = server.scene.add_label(
            "/result", caption(recording), position=position, visible=False
        )
        film = server.get_scene_serializer()
        shown = shown_moments(times, min(_MOST, math.ceil((times[-1] - times[0]) * _RATE)))
        for moment, after in zip(shown, [*shown[1:], shown[-1]], strict=True):
            bodies.move(replay.links(moment))
            label.visible = moment == shown[-1]
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


_TRAIL = 500  # frames of a live page that paths and plots show
_SECOND = "#e3d5c0", GOAL  # colours of the second robot: body, arm and paths
_LOW = 0.5  # m; shapes that reach below this height make the footprint


class _Trail:
    """The last `_TRAIL` points of a path, drawn as line segments."""

    def __init__(self, server: Any, name: str, colour: str, start: Array) -> None:
        self._points = deque([start[:3].copy()] * _TRAIL, maxlen=_TRAIL)
        self._colours = deque([rgb(colour)] * (_TRAIL - 1), maxlen=_TRAIL - 1)
        self._colour = rgb(colour)
        self._drawn = server.scene.add_line_segments(
            name, self._segments(), self._pairs(), thickness=3.0, thickness_units="screen"
        )

    def add(self, pose: Array, *, failed: bool = False) -> None:
        self._points.append(pose[:3].copy())
        self._colours.append(rgb(FAILURE) if failed else self._colour)

    def draw(self) -> None:
        self._drawn.points, self._drawn.colors = self._segments(), self._pairs()

    def _segments(self) -> Array:
        points = np.array(self._points)
        return np.stack([points[:-1], points[1:]], axis=1)

    def _pairs(self) -> Any:
        return np.repeat(np.array(self._colours, dtype=np.uint8)[:, np.newaxis], 2, axis=1)


class ShownRobot:
    """A robot in the page with its paths and footprint, all below the node `root`."""

    def __init__(
        self, server: Any, name: str, robot: Robot, policy: str, episode: "Episode", second: bool
    ) -> None:
        colours = _SECOND if second else (BODY, ARM)
        self._episode, self._failures, self._name = episode, 0, f"{robot.name}, {policy}"
        self.root = server.scene.add_frame(name, show_axes=False)
        self._target = server.scene.add_frame(
            f"{name}/target", axes_length=0.2, axes_radius=0.008, visible=second
        )
        self._robot = robot
        self._body = Bodies(server, f"{name}/robot", robot_shapes(robot, colours))
        starts = {BASE: episode.base_pose, DESIRED: episode.ee_pose, EE: episode.ee_pose}
        self._base, self._desired, self._ee = (
            _Trail(server, f"{name}/paths/{colour[1:]}", _SECOND[1] if second else colour, start)
            for colour, start in starts.items()
        )
        outline = _footprint(robot)
        self._outline = server.scene.add_line_segments(
            f"{name}/footprint", np.stack([outline, np.roll(outline, -1, axis=0)], axis=1),
            rgb(colours[1] if second else BASE), thickness=3.0, thickness_units="screen",
        )  # fmt: skip
        beside = outline.min(axis=0) * [0.0, 1.0, 0.0]  # not above the base, which it would hide
        server.scene.add_label(
            f"{name}/footprint/label", self._name, position=beside, anchor="top-center"
        )
        self.times: deque[float] = deque(maxlen=_TRAIL)
        self.deviations: deque[float] = deque(maxlen=_TRAIL)
        self.speeds: deque[Array] = deque(maxlen=_TRAIL)
        self._failed = False

    def note(self) -> None:
        """Note whether the last step of the episode failed."""
        self._failed |= not self._episode.feasible
        self._failures += not self._episode.feasible

    def report(self) -> str:
        """Return the number of IK failures and the time scale as Markdown."""
        scale = float(self._episode.loop.sequence.time_scale[0])
        reached = "the arm reached every pose"
        if self._failures:
            reached = f"out of the arm's reach in {self._failures} steps"
        return f"**{self._name}**: {reached}" + (f", slowed to {scale:.0%}" * (scale < 1.0))

    def draw(self, target: Array) -> None:
        """Show the state of the episode, and for the second robot also the target (7,)."""
        episode = self._episode
        place(self._target, target)
        self._body.move(robot_poses(self._robot, episode.base_pose, episode.joint_positions))
        self._outline.position = [*episode.base_pose[:2], 0.01]
        self._outline.wxyz = np.roll(episode.base_pose[3:], 1)
        self._base.add(episode.base_pose + np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0]))
        self._desired.add(episode.loop.desired[0], failed=self._failed)
        self._ee.add(episode.ee_pose)
        self._failed = False
        self.times.append(episode.seconds)
        self.deviations.append(1e3 * episode.deviation)
        self.speeds.append(1e2 * episode.joint_speeds)

    def draw_paths(self) -> None:
        """Show the paths up to now."""
        for trail in (self._base, self._desired, self._ee):
            trail.draw()


def _footprint(robot: Robot) -> Array:
    """Return the outline of the low parts of a body on the floor, shape (k, 3), metres."""
    body = list(robot_solids(robot, IDENTITY, robot.home["home"], ("", "arm")))
    low = [solid for solid in body if not solid.colour and corners([solid])[:, 2].min() < _LOW]
    points = corners(low or body)[:, :2]
    outline = points[ConvexHull(points).vertices]
    return np.column_stack([outline, np.zeros(len(outline))])
