"""From where to look at an episode: robot and goal in view, and as little as can be hidden."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from kinfeas.backends.pybullet.camera import LINK, Picture, show_moment, take_picture, unit_width
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.spatial import Array
from kinfeas.viz.physics.recording import PhysicsRecording

_SIDES, _ELEVATIONS = 16, np.deg2rad((25.0, 40.0))
_STEEP = 0.8  # what a view from higher up is worth of a level one
_PREVIEW, _LOOKS = (128, 96), 5
_CHEST, _AROUND = 0.7, 0.75  # m: middle of a robot above the floor, and what is to be seen around
_NEAREST, _FARTHEST = 2.0, 9.0  # m
_FILL = 1.7  # below 2, since most of what is around is empty
_CALM = 0.06  # share of the episode over which the camera's motion is smoothed
_TOUCH = 0.06  # m of depth within which something is not hidden


@dataclass(frozen=True, eq=False)
class Framing:
    """Where the camera is and looks at each of t moments, shapes (t, 3) and (t, 3), metres."""

    eye: Array
    target: Array


def frame(
    recording: PhysicsRecording, body: RobotBody, size: tuple[int, int], room: Array | None
) -> Framing:
    """Return how to look at an episode.

    The camera stays on one side, that from which most is seen, and follows robot and goal calmly.

    Args:
        recording: The episode.
        body: The robot, in the world that is shown.
        size: Width and height of the pictures in pixels.
        room: Half the size of the room along x and y, out of which the camera does not go; None
            where there are no walls.
    """
    target, distance = _follow(recording, size)
    best, eye = -1.0, target
    for side in np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False):
        for elevation in _ELEVATIONS:
            there = _place(target, distance, (side, float(elevation)), room)
            score = _score(recording, body, Framing(there, target))
            score *= 1.0 if elevation == _ELEVATIONS[0] else _STEEP
            if score > best:
                best, eye = score, there
    return Framing(eye, target)


def _follow(recording: PhysicsRecording, size: tuple[int, int]) -> tuple[Array, Array]:
    """Return what the camera looks at, shape (t, 3), and from how far away, shape (t,)."""
    chest = recording.base + np.array([0.0, 0.0, _CHEST])
    points = np.stack([chest, recording.ee, recording.goal])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    reach = np.linalg.norm(points - middle, axis=2).max(axis=0) + _AROUND
    calm = max(1.0, _CALM * len(middle))
    target: Array = gaussian_filter1d(middle, calm, axis=0, mode="nearest")
    wanted = np.clip(_FILL * reach / unit_width(size), _NEAREST, _FARTHEST)
    distance: Array = gaussian_filter1d(wanted, 2.0 * calm, mode="nearest")
    return target, distance


def _place(
    target: Array, distance: Array, direction: tuple[float, float], room: Array | None
) -> Array:
    """Return where the camera stands, shape (t, 3), looking from a side and an elevation."""
    side, elevation = direction
    level = np.array([np.cos(side), np.sin(side), 0.0]) * np.cos(elevation)
    eye = target + distance[:, np.newaxis] * (level + np.array([0.0, 0.0, np.sin(elevation)]))
    if room is not None:
        # Beyond a wall, which is 2 m high, nothing would be seen but from above.
        inside = np.clip(eye[:, :2], -room, room)
        away = np.linalg.norm(eye[:, :2] - inside, axis=1)
        eye = np.column_stack([inside, eye[:, 2] + away])
    return eye


def _score(recording: PhysicsRecording, body: RobotBody, framing: Framing) -> float:
    """Return how much is seen: of the arm, of where the EE is and should be, and of the goal."""
    total = 0.0
    for moment in np.linspace(0, len(recording.moments) - 1, _LOOKS).astype(int):
        show_moment(body.physics, recording.moments[moment])
        picture = take_picture(body.physics, framing.eye[moment], framing.target[moment], _PREVIEW)
        numbers = [body.body + LINK * (link + 1) for link in body.arm_links]
        arm = np.isin(picture.seen, numbers).mean()
        points = np.stack([recording.ee[moment], recording.goal[moment]])
        path = recording.desired[:: max(1, len(recording.desired) // 20)]
        total += (
            8.0 * min(arm, 0.05) + visible(picture, points).mean() + visible(picture, path).mean()
        )
    return total / _LOOKS


def visible(picture: Picture, points: Array) -> Array:
    """Return for each world point, shape (n, 3), whether nothing hides it in a picture, 0 or 1."""
    height, width = picture.depth.shape
    x, y, depth = picture.project(points).T
    column, row = x.astype(int), y.astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    before = picture.depth[row.clip(0, height - 1), column.clip(0, width - 1)]
    seen: Array = (inside & (depth <= before + _TOUCH)).astype(float)
    return seen
