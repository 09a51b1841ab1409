"""Films of an episode in PyBullet, rendered by PyBullet's software renderer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter1d

from kinfeas.backends.physics.stage import Stage
from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.camera import (
    FIELD_OF_VIEW,
    Moment,
    Picture,
    keep_moment,
    show_moment,
    take_picture,
)
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.policy import Policy
from kinfeas.core.spatial import Array
from kinfeas.envs.world import World
from kinfeas.evaluation.paper import TITLES
from kinfeas.evaluation.recording import Recording, record_episodes
from kinfeas.viz.episodes import side_heading
from kinfeas.viz.film import SIZE, Film
from kinfeas.viz.style import DESIRED, EE, FAILURE, GOAL

_FINER = 2  # pixels in each direction that are averaged into one
_OFF_THE_WALLS = 0.3  # m
_CHEST, _AROUND = 0.7, 0.75  # m: middle of a robot above the floor, margin of the picture
_NEAREST, _FARTHEST, _FILL = 2.0, 9.0, 1.7  # m, m, share of the picture
_AHEAD = 3.0  # s of the desired path that the camera looks ahead
_CALM = 0.06  # share of the episode over which the camera's motion is smoothed
_ELEVATION = np.deg2rad(30.0)


@dataclass(frozen=True, eq=False)
class PyBulletFilm(Film):
    """An episode in PyBullet, and a camera at `eye` directed to `target`, both (t, 3), metres."""

    moments: Sequence[Moment]
    physics: Physics
    eye: Array
    target: Array
    size: tuple[int, int] = SIZE  # pixels

    def picture(self, moment: int) -> Image.Image:
        """Return the picture of one moment with the paths until then."""
        size = _FINER * self.size[0], _FINER * self.size[1]
        show_moment(self.physics, self.moments[moment])
        seen = take_picture(self.physics, self.eye[moment], self.target[moment], size)
        image = Image.fromarray(seen.colour)
        _draw_paths(ImageDraw.Draw(image), seen, self.recording, moment)
        return image.resize(self.size, Image.Resampling.BOX)


def make_film(world: World, policy: Policy, episode: int) -> PyBulletFilm:
    """Run one episode of a PyBullet world and return its film, seen from beside the path."""
    stage = world.task
    if not isinstance(stage, Stage) or not isinstance(stage.backend, PyBulletBackend):
        raise TypeError(f"a world of the PyBullet backend is needed, not {world.config.backend}")
    stage.sample(world.solver, world.rng(episode))
    physics = stage.backend.sims[0].physics
    moments = [keep_moment(physics)]
    (recording,) = record_episodes(
        world, policy, 1, episode, lambda *_: moments.append(keep_moment(physics))
    )
    if not stage.has_success_condition:
        recording = replace(recording, task_done=None)
    target, distance = _target(recording)
    heading = side_heading(recording)
    toward = np.array([np.sin(heading), -np.cos(heading), 0.0]) * np.cos(_ELEVATION)
    toward[2] = np.sin(_ELEVATION)
    eye = target + distance[:, np.newaxis] * toward
    if stage.scene is not None:  # above the walls if it is beyond them
        room = np.array(stage.scene.size) / 2.0 - _OFF_THE_WALLS
        inside = np.clip(eye[:, :2], -room, room)
        eye[:, 2] += np.linalg.norm(eye[:, :2] - inside, axis=1)
        eye[:, :2] = inside
    title = f"{TITLES.get(world.robot.name, world.robot.name)}, {world.task.name}"
    return PyBulletFilm(recording, title, moments, physics, eye, target)


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


def _draw_paths(
    draw: ImageDraw.ImageDraw, picture: Picture, recording: Recording, moment: int
) -> None:
    """Draw goals, desired path (dashed ahead), achieved path and failures until a moment."""
    unit = picture.colour.shape[1] / 960
    desired, end = recording.desired[:, :3], moment + 1

    def line(points: Array, colour: str, width: float, drawn: NDArray[np.bool_]) -> None:
        flat = picture.project(points)
        for i in np.flatnonzero(drawn & (flat[:-1, 2] > 0.0) & (flat[1:, 2] > 0.0)):
            ends = [tuple(flat[i, :2]), tuple(flat[i + 1, :2])]
            draw.line(ends, fill=colour, width=max(1, round(width * unit)))

    def discs(points: Array, colour: str, radius: float) -> None:
        for x, y, depth in picture.project(points):
            if depth > 0.0:
                r = radius * unit
                draw.ellipse((x - r, y - r, x + r, y + r), fill=colour)

    travelled = np.cumsum(np.linalg.norm(np.diff(desired[moment:], axis=0), axis=1))
    line(desired[moment:], DESIRED, 2.2, (travelled / 0.04).astype(int) % 2 == 0)
    line(desired[:end], DESIRED, 2.6, np.ones(moment, dtype=np.bool_))
    line(recording.ee_pose[:end, :3], EE, 4.4, np.ones(moment, dtype=np.bool_))
    discs(recording.goals[:, :3], GOAL, 8.0)
    discs(desired[:end][~recording.feasible[:end]], FAILURE, 5.0)
