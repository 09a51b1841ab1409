"""A robot in a live page, with the paths of base and EE and the outline of its base."""

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull

from kinfeas.core import spatial
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.viz.pages import Bodies, place, rgb
from kinfeas.viz.shapes import corners, robot_poses, robot_shapes, robot_solids
from kinfeas.viz.style import ARM, BASE, BODY, DESIRED, EE, FAILURE, GOAL

if TYPE_CHECKING:
    from kinfeas.viz.live import Episode

_TRAIL = 500  # frames that paths and plots show
_SECOND = "#e3d5c0", GOAL  # colours of the second robot
_LOW = 0.5  # m, height of the parts that make the footprint of a base


class _Trail:
    """The last points of a path, drawn as line segments of a constant number."""

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
        front = outline.min(axis=0) * [0.0, 1.0, 0.0]  # beside the base, which it would cover
        server.scene.add_label(
            f"{name}/footprint/label", self._name, position=front, anchor="top-center"
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
        """Return how the arm keeps up, in words."""
        scale = float(self._episode.loop.sequence.time_scale[0])
        reached = "the arm reached every pose"
        if self._failures:
            reached = f"{self._failures} poses were out of the arm's reach"
        return f"**{self._name}**: {reached}" + (f", slowed to {scale:.0%}" * (scale < 1.0))

    def draw(self, target: Array) -> None:
        """Show the state of the episode, and the target of a robot that stands beside it."""
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
    body = list(robot_solids(robot, spatial.IDENTITY, robot.home["home"], ("", "arm")))
    low = [solid for solid in body if not solid.colour and corners([solid])[:, 2].min() < _LOW]
    points = corners(low or body)[:, :2]
    outline = points[ConvexHull(points).vertices]
    return np.column_stack([outline, np.zeros(len(outline))])
