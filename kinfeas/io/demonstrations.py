"""Recorded demonstrations: what the hand, the base and the object did, and the files that hold it.

A file is a CSV table or a NumPy archive of one demonstration; a folder of them is a set of
demonstrations of one motion.
"""

import csv
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.config.quantities import LONGEST, REMOTEST
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.csv_table import read_csv
from kinfeas.io.files import replacing
from kinfeas.io.npz import read_npz

_AXES = ("x", "y", "z", "qx", "qy", "qz", "qw")
_POSES = ("ee_pose", "base_pose", "object_pose")
_BASE = "base_pose"
_MOST_NAMED = 6  # folders that an error names
_NOT_UNIT = 1e-3  # how far the norm of a recorded quaternion may be from 1


@dataclass(frozen=True)
class Demonstration:
    """What was recorded at t moments, in the world.

    Attributes:
        time: Moments in seconds, strictly ascending, shape (t,), t >= 2.
        ee_pose: Poses of the hand that demonstrates, shape (t, 7).
        base_pose: Poses of its base, shape (t, 7); all NaN if there was none, which None in the
            constructor stands for.
        object_pose: Poses of the handled object, the frame that the motion is learned in,
            shape (t, 7).
    """

    time: Array
    ee_pose: Array
    base_pose: Array
    object_pose: Array

    def __post_init__(self) -> None:
        """Put NaN in the place of a base that was not recorded."""
        if self.base_pose is None:
            unknown = np.full((len(self.time), 7), np.nan)  # type: ignore[unreachable] # untyped callers
            object.__setattr__(self, "base_pose", unknown)

    @property
    def has_base(self) -> bool:
        """Whether the base was recorded."""
        return not bool(np.isnan(self.base_pose).all())


def read_demonstrations(folder: Path) -> list[Demonstration]:
    """Return the demonstrations of all `demonstration_files`, in their order.

    Raises:
        KinfeasError: If there are none, or one is not what `read_demonstration` allows.
    """
    return [read_demonstration(path) for path in demonstration_files(folder)]


def demonstration_files(folder: Path) -> list[Path]:
    """Return the CSV and NPZ files in `folder`, in the order of their names.

    Raises:
        KinfeasError: If there are none.
    """
    if not folder.is_dir():
        raise KinfeasError(f"{folder}: no such folder of demonstrations")
    paths = sorted(path for path in folder.iterdir() if _kind(path) in _READERS)
    if paths:
        return paths
    below = sorted({path.parent for path in folder.glob("*/*") if _kind(path) in _READERS})
    if below:
        names = ", ".join(str(path) for path in below[:_MOST_NAMED])
        raise KinfeasError(
            f"{folder}: holds no demonstrations itself, but folders of them; choose one: {names}"
            f"{', ...' if len(below) > _MOST_NAMED else ''}"
        )
    raise KinfeasError(f"{folder}: holds no demonstrations, which are *.csv or *.npz files")


def read_demonstration(path: Path, optional: Collection[str] = (_BASE,)) -> Demonstration:
    """Return the demonstration that a CSV or NPZ file holds, its quaternions made unit.

    Columns that are not in `columns` may be there or not.

    Args:
        path: The file.
        optional: Which of the poses may be missing from it; they are all NaN then.

    Raises:
        KinfeasError: If the file cannot be read, lacks a column, has fewer than two samples or
            numbers that are not finite, its time does not ascend or a quaternion is not unit.
    """
    reader = _READERS.get(_kind(path))
    if reader is None:
        raise KinfeasError(f"{path}: must be a .csv or .npz file")
    return reader(path, optional)


def write_demonstration(demonstration: Demonstration, path: Path) -> None:
    """Write a CSV or NPZ file, as the suffix says, that `read_demonstration` reads back.

    All of it or nothing is written: what was there stays until it is complete.

    Raises:
        KinfeasError: If the suffix is another one, the demonstration is none that could be read
            back, or the file cannot be written.
    """
    if _kind(path) not in _READERS:
        raise KinfeasError(f"{path}: must be a .csv or .npz file")
    poses = [pose for pose in _POSES if demonstration.has_base or pose != _BASE]
    arrays: dict[str, Any] = {
        name: np.asarray(getattr(demonstration, name)) for name in ("time", *poses)
    }
    _from_arrays(arrays, path)
    with replacing(path) as fresh:
        if _kind(path) == ".npz":
            # To a name that ends otherwise, such as .NPZ, it would add .npz.
            with fresh.open("wb") as archive:
                np.savez_compressed(archive, **arrays)
        else:
            with fresh.open("w", newline="", encoding="utf-8") as file:
                rows = csv.writer(file, lineterminator="\n")
                rows.writerow(columns(poses))
                rows.writerows(np.column_stack(list(arrays.values())).tolist())


def columns(poses: Iterable[str] = _POSES) -> list[str]:
    """Return the columns of a CSV file that holds the time and some of the poses."""
    return ["time", *(f"{pose.removesuffix('_pose')}_{axis}" for pose in poses for axis in _AXES)]


def _kind(path: Path) -> str:
    """Return the suffix, whether it is written in capitals or not."""
    return path.suffix.lower()


def _read_csv(path: Path, optional: Collection[str]) -> Demonstration:
    poses: list[str] = []

    def choose(header: Sequence[str]) -> list[str]:
        poses.extend(
            pose
            for pose in _POSES
            if pose not in optional or not set(header).isdisjoint(columns([pose])[1:])
        )
        return columns(poses)

    table = read_csv(path, choose)
    split = np.split(table.values[:, 1:], len(poses), axis=1)
    values = {"time": table.values[:, 0], **dict(zip(poses, split, strict=True))}
    return _checked(values, str(path), table.place)


def _read_npz(path: Path, optional: Collection[str]) -> Demonstration:
    values = read_npz(path, ("time", *_POSES))
    for name in ("time", *_POSES):
        if name not in values and name not in optional:
            raise KinfeasError(f"{path}: key {name!r} is missing")
    return _from_arrays(values, path)


def _from_arrays(values: Mapping[str, NDArray[Any]], path: Path) -> Demonstration:
    samples = values["time"].size
    for name, value in values.items():
        shape = (samples,) if name == "time" else (samples, 7)
        if value.shape != shape or value.dtype.kind not in "fiu":
            raise KinfeasError(
                f"{path}, {name}: must hold numbers of shape {shape},"
                f" not {value.dtype} of shape {value.shape}"
            )
    return _checked(values, str(path), lambda name, i: f"{path}, {name}[{i}]")


def _checked(
    values: Mapping[str, Array], source: str, place: Callable[[str, int], str]
) -> Demonstration:
    """Return the demonstration of `values`; `place(name, i)` says where sample i stands."""
    arrays = {name: np.array(value, dtype=np.float64) for name, value in values.items()}
    time = arrays.pop("time")
    if len(time) < 2:
        raise KinfeasError(f"{source}: has {len(time)} samples, at least 2 are needed")
    for name, value in (("time", time[:, np.newaxis]), *arrays.items()):
        _refuse(~np.isfinite(value).all(axis=1), name, "is not finite", place)
    stuck = np.concatenate([[False], np.diff(time) <= 0.0])
    _refuse(stuck, "time", "does not ascend from the sample before", place)
    _refuse(time - time[0] > LONGEST, "time", f"is more than {LONGEST:g} s after the first", place)
    for name, pose in arrays.items():
        away = np.any(np.abs(pose) > REMOTEST, axis=1)
        _refuse(away, name, f"is beyond {REMOTEST:,.0f} m", place)
        norm = np.sqrt(np.sum(pose[:, 3:] ** 2, axis=1))
        _refuse(np.abs(norm - 1.0) > _NOT_UNIT, name, "has no unit quaternion (xyzw)", place)
        pose[:, 3:] /= norm[:, np.newaxis]
    unknown = np.full((len(time), 7), np.nan)
    return Demonstration(time, **{name: arrays.get(name, unknown) for name in _POSES})


def _refuse(
    bad: NDArray[np.bool_], name: str, problem: str, place: Callable[[str, int], str]
) -> None:
    if bad.any():
        raise KinfeasError(f"{place(name, int(np.argmax(bad)))}: {problem}")


_READERS: dict[str, Callable[[Path, Collection[str]], Demonstration]] = {
    ".csv": _read_csv,
    ".npz": _read_npz,
}
