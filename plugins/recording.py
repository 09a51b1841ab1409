"""Recorded motions of the end-effector, from whatever wrote them."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Slerp

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, make_pose, rotation
from kinfeas.io.demonstrations import read_demonstration
from kinfeas.io.run_log import read_record
from kinfeas.plugins.path_motion import Frame

_OPTIONAL = "base_pose", "object_pose"
_RECORD = b"# kinfeas record"  # how the record of a run begins


def read_recording(path: Path, frame: Frame) -> tuple[Array, Array, Array]:
    """Return the time, shape (t,), EE poses, shape (t, 7), and the object's first pose, (7,).

    Of the record of a run, the EE poses are the desired ones: the motion that was asked for.

    Args:
        path: CSV or NPZ file of a demonstration, in which the base and the object may be missing,
            or the CSV record of a run.
        frame: What the motion is to be placed by; the object's pose is NaN if it is not known.

    Raises:
        KinfeasError: If the file is wrong, or has no object although that is needed.
    """
    if _is_record(path):
        time, ee_pose = _read_run(path)
        first = np.full(7, np.nan)
    else:
        shown = read_demonstration(path, _OPTIONAL)
        time, ee_pose, first = shown.time, shown.ee_pose, shown.object_pose[0]
    if frame == "object" and np.isnan(first).any():
        raise KinfeasError(
            f"{path}: says no pose of an object (columns object_x, ..., object_qw), which frame "
            "'object' needs; frame may be 'goal' instead"
        )
    return time, ee_pose, first


def _is_record(path: Path) -> bool:
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_RECORD)) == _RECORD


def _read_run(path: Path) -> tuple[Array, Array]:
    record = read_record(path)
    # A run's last line says how it ended, at the time of the line before.
    later = np.diff(record.time, prepend=-np.inf) > 0.0
    time, desired = record.time[later], record.desired[later]
    if len(time) < 2 or (np.diff(time) <= 0.0).any():
        raise KinfeasError(f"{path}: must have 2 moments at least, and their time must ascend")
    return time, make_pose(desired[:, :3], rotation(desired))


def resampled(time: Array, poses: Array, shares: Array) -> Array:
    """Return the poses at `shares` of the time, straight from each sample to the next.

    Args:
        time: Moments, strictly ascending, shape (t,).
        poses: Poses then, shape (t, 7).
        shares: Ascending numbers in [0, 1], shape (m,).
    """
    moments = np.minimum(time[0] + shares * (time[-1] - time[0]), time[-1])
    position = np.stack([np.interp(moments, time, poses[:, i]) for i in range(3)], axis=-1)
    return make_pose(position, Slerp(time, rotation(poses))(moments))
