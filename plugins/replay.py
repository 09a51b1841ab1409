"""The `replay` motion: a recorded motion of the end-effector, once more."""

from pathlib import Path

from kinfeas.plugins.path_motion import (
    PathMotion,
    checked_frame,
    even_moments,
    in_frame,
    path_through,
)
from kinfeas.plugins.phase import PhaseControl
from kinfeas.plugins.recording import read_recording, resampled


class Replay(PathMotion):
    """A recorded motion, in its own time and from any start.

    The hand first comes to where the recording begins. Then it moves as recorded, and slower where
    the recording is faster than the limits.

    Args:
        file: CSV or NPZ file of a demonstration, or the CSV record of a run of `kinfeas deploy`.
        frame: Where the motion takes place: `goal` lays its end on the target; `object` puts it
            about the target as it was about the recorded object when the recording began; `world`
            repeats it in the world, wherever the target is.
        gain: Rate at which errors decay, 1/s.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.

    Raises:
        KinfeasError: If the file is wrong, there is no such frame or a number is not positive.
    """

    def __init__(
        self,
        *,
        file: str,
        frame: str = "goal",
        gain: float = 1.0,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        placed = checked_frame(frame)
        time, ee_pose, object_pose = read_recording(Path(file), placed)
        duration = float(time[-1] - time[0])
        knots = in_frame(resampled(time, ee_pose, even_moments(duration)), placed, object_pose)
        control = PhaseControl(
            path=path_through(knots),
            duration=duration,
            gain=gain,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )
        super().__init__(control, placed == "world")
