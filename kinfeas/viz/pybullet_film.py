"""Films of an episode in PyBullet, rendered by PyBullet's software renderer."""

import tempfile
from dataclasses import dataclass, field
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
from kinfeas.control.loop import Rows
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.episodes import run_episodes
from kinfeas.envs.world import Transition, World
from kinfeas.evaluation.paper import TITLES
from kinfeas.io.run_log import TASK_DONE
from kinfeas.viz.film import SIZE, write_caption
from kinfeas.viz.style import DESIRED, EE, FAILURE, GOAL

_RATE = 25.0  # moments recorded per second, at most
_FINER = 2  # pixels in each direction that are averaged into one
_TILES = ((236, 238, 241), (218, 222, 228))
_OFF_THE_WALLS = 0.3  # m
_HIDDEN = 0.3  # opacity of hidden lines
_TOUCH = 0.06  # m of depth within which a point is visible
_SIDES, _ELEVATION, _LOOKS, _PREVIEW = 16, np.deg2rad(30.0), 5, (128, 96)
_CHEST, _AROUND = 0.7, 0.75  # m: middle of a robot above the floor, margin of the picture
_NEAREST, _FARTHEST, _FILL = 2.0, 9.0, 1.7  # m, m, share of the picture
_CALM = 0.06  # share of the episode over which the camera's motion is smoothed


@dataclass(frozen=True, eq=False)
class PyBulletRecording:
    """One episode at t moments.

    Attributes:
        times: Seconds since the start, shape (t,).
        moments: State of all bodies.
        base: World position of the base, shape (t, 3).
        ee: Achieved world position of the EE without sensor errors, shape (t, 3).
        desired: Desired world position of the EE, shape (t, 3).
        goal: World position of the EE at the end of the present sub-goal, shape (t, 3).
        failures: Number of IK failures since the previous moment, shape (t,).
        reached: Whether the goal was reached.
        done: Whether the task's success condition was met; None without one.
    """

    times: Array
    moments: tuple[Moment, ...]
    base: Array
    ee: Array
    desired: Array
    goal: Array
    failures: NDArray[np.intp]
    reached: bool
    done: bool | None

    @property
    def outcome(self) -> str:
        """Result of the episode as a text."""
        return ("goal reached" if self.reached else "goal not reached") + TASK_DONE[self.done]

    @property
    def succeeded(self) -> bool:
        """Whether the goal was reached and the task, if there is one, was done."""
        return self.reached and self.done is not False

    @property
    def goals(self) -> Array:
        """Positions of all sub-goals in order, shape (sub-goals, 3)."""
        changes = np.any(np.diff(self.goal, axis=0) != 0.0, axis=1)
        return self.goal[np.concatenate([[True], changes])]


def record(world: World, policy: Policy, episode: int) -> PyBulletRecording:
    """Run one episode of a PyBullet world and return it; the world is left at its end."""
    stage = _stage(world)
    kept = _Recorder(stage, max(1, round(1.0 / (_RATE * world.config.dt))))
    records = run_episodes(world, policy, 1, watch=kept, first=episode)
    done = records.task_done
    base, ee, desired, goal = (np.array(rows) for rows in zip(*kept.places, strict=True))
    return PyBulletRecording(
        np.array(kept.times), tuple(kept.moments), base, ee, desired, goal,
        np.array(kept.failures), bool(records.reached[0]),
        bool(done[0]) if done is not None and stage.has_success_condition else None,
    )  # fmt: skip


def _stage(world: World) -> Stage:
    if not isinstance(world.task, Stage):
        raise TypeError(f"a world of the PyBullet backend is needed, not {world.config.backend}")
    return world.task


@dataclass
class _Recorder:
    stage: Stage
    every: int
    steps: int = 0
    failed: int = 0
    times: list[float] = field(default_factory=list)
    moments: list[Moment] = field(default_factory=list)
    places: list[tuple[Array, ...]] = field(default_factory=list)
    failures: list[int] = field(default_factory=list)

    def __call__(self, world: World, transition: Transition, rows: Rows, episodes: Rows) -> None:
        self.failed += int(not transition.step.feasible[0])
        if self.steps % self.every == 0 or transition.done[0]:
            loop = world.loop
            self.times.append((self.steps + 1) * loop.dt)
            self.moments.append(keep_moment(self.stage.backend.sims[0].physics))
            seen = (*loop.true_state, loop.desired, loop.goal)
            self.places.append(tuple(pose[0, :3].copy() for pose in seen))
            self.failures.append(self.failed)
            self.failed = 0
        self.steps += 1


@dataclass(frozen=True, eq=False)
class PyBulletFilm:
    """An episode in PyBullet, to be written by `write_film`.

    Attributes:
        recording: The episode.
        physics: A world with the same bodies.
        eye: Position of the camera, shape (t, 3), metres.
        target: Position in the middle of the picture, shape (t, 3).
        title: First words of the caption.
        size: Width and height of the pictures in pixels.
    """

    recording: PyBulletRecording
    physics: Physics
    eye: Array
    target: Array
    title: str
    size: tuple[int, int] = SIZE

    @property
    def times(self) -> Array:
        """Seconds since the start of the episode, shape (t,)."""
        return self.recording.times

    def picture(self, moment: int, speed: float = 1.0) -> Image.Image:
        """Return the picture of one moment; its caption gives the playback speed."""
        width, height = (_FINER * side for side in self.size)
        show_moment(self.physics, self.recording.moments[moment])
        seen = take_picture(self.physics, self.eye[moment], self.target[moment], (width, height))
        image = Image.fromarray(seen.colour).convert("RGBA")
        image.alpha_composite(_paths(seen, self.recording, moment))
        small = image.convert("RGB").resize(self.size, Image.Resampling.BOX)
        kept = self.recording
        failures = int(kept.failures[: moment + 1].sum())
        end = (kept.outcome, kept.succeeded) if moment == len(kept.moments) - 1 else None
        write_caption(small, self.title, (self.times[moment], speed), failures, end)
        return small


def make_film(world: World, recording: PyBulletRecording) -> PyBulletFilm:
    """Return the film of a recorded episode, whose camera follows robot and goal on one side."""
    stage = _stage(world)
    simulation, scene = stage.backend.sims[0], stage.scene
    room = None if scene is None else np.array(scene.size) / 2.0 - _OFF_THE_WALLS
    target, distance = _target(recording)
    eyes = [
        _eye(target, distance, side, room)
        for side in np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ]
    eye = max(eyes, key=lambda one: _visibility(recording, simulation.body, one, target))
    name = world.robot.name
    with tempfile.TemporaryDirectory() as folder:
        tiles = np.array([[_TILES[0], _TILES[1]], [_TILES[1], _TILES[0]]], dtype=np.uint8)
        texture = Path(folder) / "floor.png"
        Image.fromarray(np.kron(tiles, np.ones((128, 128, 1), dtype=np.uint8))).save(texture)
        paint_floor(simulation.physics, texture)
    title = f"{TITLES.get(name, name)}, {world.task.name}"
    return PyBulletFilm(recording, simulation.physics, eye, target, title)


def _target(recording: PyBulletRecording) -> tuple[Array, Array]:
    """Return the smoothed middle of robot and goal (t, 3), and the camera's distance (t,)."""
    chest = recording.base + np.array([0.0, 0.0, _CHEST])
    points = np.stack([chest, recording.ee, recording.goal])
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


def _visibility(recording: PyBulletRecording, body: RobotBody, eye: Array, target: Array) -> float:
    """Return a score for the visibility of arm, EE, goal and path."""
    total = 0.0
    numbers = [body.body + LINK * (link + 1) for link in body.arm_links]
    path = recording.desired[:: max(1, len(recording.desired) // 20)]
    for moment in np.linspace(0, len(recording.moments) - 1, _LOOKS).astype(int):
        show_moment(body.physics, recording.moments[moment])
        picture = take_picture(body.physics, eye[moment], target[moment], _PREVIEW)
        ends = np.stack([recording.ee[moment], recording.goal[moment]])
        arm = min(float(np.isin(picture.seen, numbers).mean()), 0.05)
        total += 8.0 * arm + _visible(picture, ends).mean() + _visible(picture, path).mean()
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


def _paths(picture: Picture, recording: PyBulletRecording, moment: int) -> Image.Image:
    """Return a layer with goals, desired path (dashed ahead), achieved path and failures."""
    height, width = picture.depth.shape
    layer = Image.new("RGBA", (width, height))
    draw, unit = ImageDraw.Draw(layer), width / 960
    ahead, behind = recording.desired[moment:], recording.desired[: moment + 1]
    travelled = np.cumsum(np.linalg.norm(np.diff(ahead, axis=0), axis=1))
    _line(draw, picture, ahead, DESIRED, 2.2 * unit, (travelled / 0.04).astype(int) % 2 == 0)
    _line(draw, picture, behind, DESIRED, 2.6 * unit)
    _line(draw, picture, recording.ee[: moment + 1], EE, 4.4 * unit)
    _discs(draw, picture, recording.goals, GOAL, 8.0 * unit)
    _discs(draw, picture, behind[recording.failures[: moment + 1] > 0], FAILURE, 5.0 * unit)
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
