"""Recorded demonstrations of an EE, a base and an object, in CSV files."""

import logging
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import read_csv, write_csv
from kinfeas.core.quantities import LONGEST, REMOTEST
from kinfeas.core.spatial import POSE_COLUMNS, UNIT, Array

_POSES = ("ee_pose", "base_pose", "object_pose")
_GAP, _STEPS, _MOTION = 0.5, 10.0, 0.01  # least seconds, median steps and EE metres of a gap
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Demonstration:
    """Poses in the world at t times."""

    time: Array  # times in seconds, strictly ascending, shape (t,), t >= 2
    ee_pose: Array  # poses of the demonstrating EE, shape (t, 7)
    base_pose: Array  # poses of the demonstrating base, (t, 7); all NaN if it was not recorded
    object_pose: Array  # poses of the grasped object, the frame of the learned motion, shape (t, 7)

    @property
    def has_base(self) -> bool:
        """Whether the base was recorded."""
        return not bool(np.isnan(self.base_pose).all())


def demonstration_files(source: Path) -> list[Path]:
    """Return a file, or the CSV files of a folder by name; raise KinfeasError if it has none."""
    if not source.is_dir():
        return [source]
    paths = sorted(source.glob("*.csv"))
    if not paths:
        raise KinfeasError(f"{source}: has no demonstrations (*.csv)")
    return paths


def read_demonstration(path: Path, optional: Collection[str] = ("base_pose",)) -> Demonstration:
    """Return the demonstration in a CSV file, with normalized quaternions.

    Poses that are `optional` may be missing and are NaN then; other columns are ignored. A warning
    names the longest gap between samples, if it is unusually long and the EE moves in it.

    Raises:
        KinfeasError: If the file cannot be read, lacks a column, has fewer than two samples,
            non-finite numbers, times that do not ascend or quaternions that are not unit.
    """
    values = read_csv(path, columns(), [name for pose in optional for name in columns(pose)])
    poses, time = {}, values["time"]
    for kind in _POSES:
        missing = [name for name in columns(kind) if name not in values]
        if not missing:
            poses[kind] = np.stack([values[name] for name in columns(kind)], axis=1)
        elif len(missing) < len(POSE_COLUMNS):
            raise KinfeasError(f"{path}: column {missing[0]!r} is missing")
    check_samples(path, time, poses)
    steps, displacements = np.diff(time), np.diff(poses["ee_pose"][:, :3], axis=0)
    longest = int(steps.argmax())
    moved = float(np.linalg.norm(displacements[longest]))
    if steps[longest] > max(_GAP, _STEPS * float(np.median(steps))) and moved > _MOTION:
        _log.warning(
            "%s: without samples for %.2g s after %.2f s, in which the EE moves by %.2g m: it is "
            "interpolated", path, steps[longest], time[longest], moved,
        )  # fmt: skip
    for pose in poses.values():
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    unknown = np.full((len(time), 7), np.nan)
    return Demonstration(time, **{name: poses.get(name, unknown) for name in _POSES})


def write_demonstration(demonstration: Demonstration, path: Path) -> None:
    """Write a CSV file atomically; errors are those of `read_demonstration`."""
    names = [name for name in _POSES if demonstration.has_base or name != "base_pose"]
    poses = {name: getattr(demonstration, name) for name in names}
    check_samples(path, demonstration.time, poses)
    header = ["time", *(name for pose in names for name in columns(pose))]
    write_csv(path, header, np.column_stack([demonstration.time, *poses.values()]).tolist())


def columns(pose: str | None = None) -> list[str]:
    """Return the columns of a pose, by default those of a file with all poses."""
    if pose is None:
        return ["time", *(name for pose in _POSES for name in columns(pose))]
    return [f"{pose.removesuffix('_pose')}_{axis}" for axis in POSE_COLUMNS]


def unit_hint(time: Array) -> str:
    """Return a hint for errors on too long times, shape (t,): the unit that they may have."""
    step = float(np.median(np.diff(time)))
    # In the right unit, samples are 1 ms to 1 s apart.
    for unit, factor in (("nanoseconds", "1e9"), ("microseconds", "1e6"), ("milliseconds", "1e3")):
        if 1e-3 <= step / float(factor) < 1.0:
            return f"; are these {unit}? Divide them by {factor} for seconds"
    return ""


def check_samples(path: Path, time: Array, poses: dict[str, Array]) -> None:
    """Raise KinfeasError on the first invalid sample of poses (t, 7) at ascending times (t,)."""

    def require(holds: NDArray[np.bool_], rule: str) -> None:
        if not holds.all():
            raise KinfeasError(f"{path}, row {int(np.argmin(holds)) + 1}: {rule}")

    if len(time) < 2:
        raise KinfeasError(f"{path}: has {len(time)} samples, at least 2 are needed")
    require(np.diff(time, prepend=-np.inf) > 0.0, "time does not ascend")
    require(
        time - time[0] <= LONGEST,
        f"time is more than {LONGEST:g} s after the first{unit_hint(time)}",
    )
    for name, pose in poses.items():
        for axis, values in zip(POSE_COLUMNS, pose.T, strict=True):
            rule = f"{name}: {axis} is missing, not finite or beyond {REMOTEST:,.0f} m"
            require(np.abs(values) <= REMOTEST, rule)
        norm = np.linalg.norm(pose[:, 3:], axis=1)
        require(np.abs(norm - 1.0) <= UNIT, f"{name} has no unit quaternion (xyzw)")
