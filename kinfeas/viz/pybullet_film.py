"""Films of an episode in PyBullet, rendered by PyBullet's software renderer."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter1d

from kinfeas.backends.pybullet.camera import (
    FIELD_OF_VIEW,
    LINK,
    Moment,
    Picture,
    keep_moment,
    paint_floor,
    show_moment,
    take_picture,
)
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.backends.pybullet.stage import Stage
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.world import World
from kinfeas.evaluation.paper import TITLES
from kinfeas.evaluation.recording import Recording, record_episodes
from kinfeas.viz.film import SIZE
from kinfeas.viz.style import DESIRED, EE, FAILURE, GOAL

_FINER = 2  # pixels in each direction that are averaged into one
_TILES = ((236, 238, 241), (218, 222, 228))
_OFF_THE_WALLS = 0.3  # m
_HIDDEN = 0.3  # opacity of hidden lines
_TOUCH = 0.06  # m of depth within which a point is visible
_SIDES, _ELEVATION, _LOOKS, _PREVIEW = 16, np.deg2rad(30.0), 5, (128, 96)
_CHEST, _AROUND = 0.7, 0.75  # m: middle of a robot above the floor, margin of the picture
_NEAREST, _FARTHEST, _FILL = 2.0, 9.0, 1.7  # m, m, share of the picture
_AHEAD = 3.0  # s of the desired path that the camera looks ahead
_CALM = 0.06  # share of the episode over which the camera's motion is smoothed


@dataclass(frozen=True, eq=False)
class PyBulletFilm:
    """An episode in PyBullet, to be written by `write_film`.

    Attributes:
        recording: The episode.
        moments: State of all bodies at each moment.
        physics: A world with the same bodies.
        eye: Position of the camera, shape (t, 3), metres.
        target: Position in the middle of the picture, shape (t, 3).
        title: First words of the caption.
        size: Width and height of the pictures in pixels.
    """

    recording: Recording
    moments: Sequence[Moment]
    physics: Physics
    eye: Array
    target: Array
    title: str
    size: tuple[int, int] = SIZE

    def picture(self, moment: int) -> Image.Image:
        """Return the picture of one moment with the paths until then."""
        size = _FINER * self.size[0], _FINER * self.size[1]
        show_moment(self.physics, self.moments[moment])
        seen = take_picture(self.physics, self.eye[moment], self.target[moment], size)
        image = Image.fromarray(seen.colour).convert("RGBA")
        image.alpha_composite(_paths(seen, self.recording, moment))
        return image.convert("RGB").resize(self.size, Image.Resampling.BOX)


def make_film(world: World, policy: Policy, episode: int) -> PyBulletFilm:
    """Run one episode of a PyBullet world and return its film.

    The camera follows robot and EE on the side from which most of the arm and the path is visible.
    """
    stage = world.task
    if not isinstance(stage, Stage):
        raise TypeError(f"a world of the PyBullet backend is needed, not {world.config.backend}")
    stage.sample(world.solver, world.rng(episode))
    body, physics = stage.backend.sims[0].body, stage.backend.sims[0].physics
    moments = [keep_moment(physics)]
    (recording,) = record_episodes(
        world, policy, 1, episode, lambda *_: moments.append(keep_moment(physics))
    )
    if not stage.has_success_condition:
        recording = replace(recording, task_done=None)
    room = None if stage.scene is None else np.array(stage.scene.size) / 2.0 - _OFF_THE_WALLS
    target, distance = _target(recording)
    eyes = [
        _eye(target, distance, side, room)
        for side in np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ]
    eye = max(eyes, key=lambda one: _visibility(recording, moments, body, (one, target)))
    with tempfile.TemporaryDirectory() as folder:
        tiles = np.array([[_TILES[0], _TILES[1]], [_TILES[1], _TILES[0]]], dtype=np.uint8)
        texture = Path(folder) / "floor.png"
        Image.fromarray(np.kron(tiles, np.ones((128, 128, 1), dtype=np.uint8))).save(texture)
        paint_floor(physics, texture)
    title = f"{TITLES.get(world.robot.name, world.robot.name)}, {world.task.name}"
    return PyBulletFilm(recording, moments, physics, eye, target, title)


def _target(recording: Recording) -> tuple[Array, Array]:
    """Return the smoothed middle of robot and path ahead (t, 3), and the camera's distance (t,)."""
    chest = recording.base_pose[:, :3] + np.array([0.0, 0.0, _CHEST])
    last = len(chest) - 1
    ahead = np.minimum(np.arange(last + 1) + round(_AHEAD / recording.dt), last)
    points = np.stack([chest, recording.ee_pose[:, :3], recording.desired[ahead, :3]])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    reach = np.linalg.norm(points - middle, axis=2).max(axis=0) + _AROUND
    calm = max(1.0, _CALM * len(middle))
    target: Array = gaussian_filter1d(middle, calm, axis=0, mode="nearest")
    width = 2.0 * np.tan(FIELD_OF_VIEW / 2.0)  # of a picture at a distance of 1
    wanted = np.clip(_FILL * reach / width, _NEAREST, _FARTHEST)
    distance: Array = gaussian_filter1d(wanted, 2.0 * calm, mode="nearest")
    return target, distance


def _eye(target: Array, distance: Array, side: float, room: Array | None) -> Array:
    """Return positions of a camera (t, 3) that looks from a side, within the walls."""
    level = np.array([np.cos(side), np.sin(side), 0.0]) * np.cos(_ELEVATION)
    up = np.array([0.0, 0.0, np.sin(_ELEVATION)])
    eye = target + distance[:, np.newaxis] * (level + up)
    if room is not None:
        inside = np.clip(eye[:, :2], -room, room)
        outside = np.linalg.norm(eye[:, :2] - inside, axis=1)
        eye = np.column_stack([inside, eye[:, 2] + outside])
    return eye


def _visibility(
    recording: Recording, moments: Sequence[Moment], body: RobotBody, view: tuple[Array, Array]
) -> float:
    """Return a score for the visibility of arm, EE and desired path."""
    total, last = 0.0, len(moments) - 1
    numbers = [body.body + LINK * (link + 1) for link in body.arm_links]
    path = recording.desired[:: max(1, last // 20), :3]
    for moment in np.linspace(0, last, _LOOKS).astype(int):
        show_moment(body.physics, moments[moment])
        eye, target = (one[moment] for one in view)
        picture = take_picture(body.physics, eye, target, _PREVIEW)
        arm = min(float(np.isin(picture.seen, numbers).mean()), 0.05)
        ee = _visible(picture, recording.ee_pose[[moment], :3])
        total += 8.0 * arm + ee.mean() + _visible(picture, path).mean()
    return total


def _visible(picture: Picture, points: Array) -> Array:
    """Return 1 for visible world points, shape (n, 3), 0 for hidden ones, shape (n,)."""
    height, width = picture.depth.shape
    x, y, depth = picture.project(points).T
    column, row = x.astype(int), y.astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    before = picture.depth[row.clip(0, height - 1), column.clip(0, width - 1)]
    seen: Array = (inside & (depth <= before + _TOUCH)).astype(float)
    return seen


def _paths(picture: Picture, recording: Recording, moment: int) -> Image.Image:
    """Return a layer with goals, desired path (dashed ahead), achieved path and failures."""
    height, width = picture.depth.shape
    layer = Image.new("RGBA", (width, height))
    draw, unit = ImageDraw.Draw(layer), width / 960
    desired, end = recording.desired[:, :3], moment + 1
    travelled = np.cumsum(np.linalg.norm(np.diff(desired[moment:], axis=0), axis=1))
    dashes = (travelled / 0.04).astype(int) % 2 == 0
    _line(draw, picture, desired[moment:], DESIRED, 2.2 * unit, dashes)
    _line(draw, picture, desired[:end], DESIRED, 2.6 * unit)
    _line(draw, picture, recording.ee_pose[:end, :3], EE, 4.4 * unit)
    _discs(draw, picture, recording.goals[:, :3], GOAL, 8.0 * unit)
    failed = desired[:end][~recording.feasible[:end]]
    _discs(draw, picture, failed, FAILURE, 5.0 * unit)
    return layer


def _line(
    draw: ImageDraw.ImageDraw,
    picture: Picture,
    points: Array,
    colour: str,
    width: float,
    drawn: NDArray[np.bool_] | None = None,
) -> None:
    """Draw a line through world points (n, 3); `drawn` (n - 1,) selects its segments."""
    flat, visible = picture.project(points), _visible(picture, points)
    for i in range(len(points) - 1):
        if (drawn is None or drawn[i]) and min(flat[i, 2], flat[i + 1, 2]) > 0.0:
            opacity = 1.0 if visible[i] and visible[i + 1] else _HIDDEN
            ends = [tuple(flat[i, :2]), tuple(flat[i + 1, :2])]
            draw.line(ends, fill=_rgba(colour, opacity), width=max(1, round(width)))


def _discs(
    draw: ImageDraw.ImageDraw, picture: Picture, points: Array, colour: str, radius: float
) -> None:
    for (x, y, depth), seen in zip(picture.project(points), _visible(picture, points), strict=True):
        if depth > 0.0:
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(box, fill=_rgba(colour, 1.0 if seen else _HIDDEN))


@cache
def _rgba(colour: str, opacity: float) -> tuple[int, int, int, int]:
    red, green, blue = (round(255.0 * part) for part in to_rgb(colour))
    return red, green, blue, round(255.0 * opacity)
