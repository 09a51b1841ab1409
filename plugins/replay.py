"""The `replay` motion: a recorded EE motion, and the files that it comes from."""

from pathlib import Path

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Positive
from kinfeas.core.spatial import Array, interpolated, make_pose, rotation
from kinfeas.io.demonstrations import read_demonstration
from kinfeas.io.run_log import is_record, read_record
from kinfeas.plugins.path import FIRST, Frame, PathMotion, PosePath, even_fractions, in_frame


class Replay(PathMotion):
    """A recorded motion, in its own time and from any start.

    The EE first comes to the beginning of the recording. Then it moves as recorded, and slower
    where the recording is faster than the limits.

    Args:
        file: CSV file of a demonstration, or the CSV record of a run of `kinfeas deploy`.
        frame: `goal` puts the end of the motion on the target; `object` places the motion relative
            to the target as it was relative to the recorded object at the beginning; `world`
            repeats it in the world, wherever the target is.
        gain: Rate at which errors decay, 1/s.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
        waits: Whether the motion waits for an EE that is away from it; otherwise the EE catches up.
    """

    def __init__(
        self,
        *,
        file: str,
        frame: Frame = "goal",
        gain: Positive = 1.0,
        max_velocity: Positive = 0.1,
        max_angular_velocity: Positive = 0.1,
        waits: bool = True,
    ) -> None:
        time, ee_pose, object_pose = read_recording(Path(file), frame)
        duration = float(time[-1] - time[0])
        knots = in_frame(resampled(time, ee_pose, even_fractions(duration)), frame, object_pose)
        scales = {} if waits else {"position_scale": np.inf, "rotation_scale": np.inf}
        super().__init__(
            path=PosePath(knots),
            duration=duration,
            in_world=frame == "world",
            gain=gain,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
            first=FIRST,
            **scales,
        )


def read_recording(path: Path, frame: Frame) -> tuple[Array, Array, Array]:
    """Return the time, shape (t,), EE poses, shape (t, 7), and the object's first pose, (7,).

    The file is a demonstration, in which the base and the object may be missing, or the CSV record
    of a run, of which the desired EE poses are read. The pose of an unknown object is NaN, and an
    error if `frame` needs it.
    """
    if path.is_file() and is_record(path):
        record = read_record(path)
        time, desired = record.time[record.later], record.desired[record.later]
        if len(time) < 2 or (np.diff(time) <= 0.0).any():
            raise KinfeasError(f"{path}: must have 2 moments at least, and their time must ascend")
        ee_pose, first = make_pose(desired[:, :3], rotation(desired)), np.full(7, np.nan)
    else:
        try:
            demonstration = read_demonstration(path, ("base_pose", "object_pose"))
        except KinfeasError as error:
            if "column" not in str(error):
                raise
            raise KinfeasError(f"{error}; poses alone are for the motion 'waypoints'") from error
        time, ee_pose = demonstration.time, demonstration.ee_pose
        first = demonstration.object_pose[0]
    if frame == "object" and np.isnan(first).any():
        raise KinfeasError(
            f"{path}: no pose of an object (columns object_x, ..., object_qw), which frame "
            "'object' needs; frame may be 'goal' instead"
        )
    return time, ee_pose, first


def resampled(time: Array, poses: Array, fractions: Array) -> Array:
    """Return poses, (t, 7), interpolated at ascending `fractions` of their time, 0-1, (m, 7)."""
    moments = np.minimum(time[0] + fractions * (time[-1] - time[0]), time[-1])
    return interpolated(moments, time, poses)
