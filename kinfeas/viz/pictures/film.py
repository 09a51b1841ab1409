"""An episode in the analytic world as a film."""

from dataclasses import dataclass

import numpy as np
from PIL import Image

from kinfeas.core.spatial import Array
from kinfeas.evaluation.recording import Recording
from kinfeas.robots.robot import Robot
from kinfeas.viz.physics.overlay import write_below
from kinfeas.viz.pictures.moment import Camera, moment_image, watch


@dataclass(frozen=True, eq=False)
class AnalyticFilm:
    """An episode, which `write_film` writes.

    Attributes:
        recording: What happened.
        robot: Who moves.
        title: What stands below, before the time.
        camera: From where to look.
    """

    recording: Recording
    robot: Robot
    title: str
    camera: Camera

    @property
    def times(self) -> Array:
        """Seconds since the start of the episode, shape (t,)."""
        return np.arange(len(self.recording.feasible), dtype=np.float64) * self.recording.dt

    def picture(self, moment: int, speed: float = 1.0) -> Image.Image:
        """Return the picture of one moment; its caption says how many times faster it is shown."""
        kept, past = self.recording, slice(0, moment + 1)
        paths = (kept.base_pose[past, :3], kept.ee_pose[past, :3], kept.desired[past, :3])
        posture = kept.base_pose[moment], kept.joint_positions[moment]
        failed = ~kept.feasible[past]
        goals = kept.goals[:, :3]
        image = Image.fromarray(
            moment_image(self.robot, posture, paths, goals, self.camera, failed)
        )
        end = None
        if moment == len(kept.feasible) - 1:
            end = ("goal reached" if kept.reached else "goal not reached", kept.reached)
        write_below(image, self.title, (self.times[moment], speed), int(failed.sum()), end)
        return image


def analytic_film(recording: Recording, robot: Robot, title: str) -> AnalyticFilm:
    """Return the film of an episode, seen from beside its way."""
    points = np.concatenate([recording.base_pose[:, :3], recording.desired[:, :3]])
    camera = watch(recording.base_pose[0, :3], recording.goal[:3], points)
    return AnalyticFilm(recording, robot, title, camera)
