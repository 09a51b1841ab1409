"""Recorded demonstrations of an EE, a base and an object, in CSV and NPZ files."""

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
from kinfeas.io.files import replacing
from kinfeas.io.formats import read_csv, read_npz

_AXES = ("x", "y", "z", "qx", "qy", "qz", "qw")
_POSES = ("ee_pose", "base_pose", "object_pose")
_BASE = "base_pose"
_SUFFIXES = (".csv", ".npz")
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Demonstration:
    """Poses in the world at t times.

    Attributes:
        time: Times in seconds, strictly ascending, shape (t,), t >= 2.
        ee_pose: Poses of the demonstrating EE, shape (t, 7).
        base_pose: Poses of its base, shape (t, 7); all NaN if it was not recorded.
        object_pose: Poses of the handled object, the frame of the learned motion, shape (t, 7).
    """

    time: Array
    ee_pose: Array
    base_pose: Array
    object_pose: Array

    @property
    def has_base(self) -> bool:
        """Whether the base was recorded."""
        return not bool(np.isnan(self.base_pose).all())


def demonstration_files(folder: Path) -> list[Path]:
    """Return the CSV and NPZ files in `folder` by name; raise KinfeasError if there are none."""
    if not folder.is_dir():
        raise KinfeasError(f"{folder}: no such folder of demonstrations")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    if not paths:
        raise KinfeasError(f"{folder}: holds no demonstrations (*.csv or *.npz)")
    return paths


def read_demonstration(path: Path, optional: Collection[str] = (_BASE,)) -> Demonstration:
    """Return the demonstration in a CSV or NPZ file, with normalized quaternions.

    Poses that are `optional` may be missing and are NaN then; other columns are ignored.

    Raises:
        KinfeasError: If the file cannot be read, lacks a column, has fewer than two samples,
            non-finite numbers, times that do not ascend or quaternions that are not unit.
    """
    if _known_suffix(path) == ".csv":
        return _read_csv(path, optional)
    values = read_npz(path, ("time", *_POSES))
    for name in ("time", *_POSES):
        if name not in values and name not in optional:
            raise KinfeasError(f"{path}: key {name!r} is missing")
    return _from_arrays(values, path)


def write_demonstration(demonstration: Demonstration, path: Path) -> None:
    """Write a CSV or NPZ file atomically.

    Raises:
        KinfeasError: If the suffix is another one, `read_demonstration` would raise, or the file
            cannot be written.
    """
    suffix = _known_suffix(path)
    poses = [pose for pose in _POSES if demonstration.has_base or pose != _BASE]
    arrays: dict[str, Any] = {
        name: np.asarray(getattr(demonstration, name)) for name in ("time", *poses)
    }
    _from_arrays(arrays, path)
    with replacing(path) as fresh:
        if suffix == ".npz":
            with fresh.open("wb") as archive:  # savez would append .npz to .NPZ
                np.savez_compressed(archive, **arrays)
        else:
            with fresh.open("w", newline="", encoding="utf-8") as file:
                rows = csv.writer(file, lineterminator="\n")
                rows.writerow(columns(poses))
                rows.writerows(np.column_stack(list(arrays.values())).tolist())


def columns(poses: Iterable[str] = _POSES) -> list[str]:
    """Return the columns of a CSV file with the time and some of the poses."""
    return ["time", *(f"{pose.removesuffix('_pose')}_{axis}" for pose in poses for axis in _AXES)]


def _known_suffix(path: Path) -> str:
    if (suffix := path.suffix.lower()) not in _SUFFIXES:
        raise KinfeasError(f"{path}: must be a .csv or .npz file")
    return suffix


def _read_csv(path: Path, optional: Collection[str]) -> Demonstration:
    poses: list[str] = []

    def choose(header: Sequence[str]) -> list[str]:
        given = (pose for pose in _POSES if not set(header).isdisjoint(columns([pose])[1:]))
        poses.extend(sorted({*given, *(set(_POSES) - set(optional))}, key=_POSES.index))
        return columns(poses)

    table = read_csv(path, choose)
    split = np.split(table.values[:, 1:], len(poses), axis=1)
    values = {"time": table.values[:, 0], **dict(zip(poses, split, strict=True))}
    return _checked(values, path, table.place)


def _from_arrays(values: Mapping[str, NDArray[Any]], path: Path) -> Demonstration:
    samples = values["time"].size
    for name, value in values.items():
        shape = (samples,) if name == "time" else (samples, 7)
        if value.shape != shape or value.dtype.kind not in "fiu":
            raise KinfeasError(
                f"{path}, {name}: must hold numbers of shape {shape},"
                f" not {value.dtype} of shape {value.shape}"
            )
    return _checked(values, path, lambda name, i: f"{path}, {name}[{i}]")


def _checked(
    values: Mapping[str, Array], path: Path, place: Callable[[str, int], str]
) -> Demonstration:
    """Return the demonstration; `place(name, i)` describes sample i in errors."""

    def require(holds: NDArray[np.bool_], name: str, problem: str) -> None:
        if not holds.all():
            raise KinfeasError(f"{place(name, int(np.argmin(holds)))}: {problem}")

    arrays = {name: np.array(value, dtype=np.float64) for name, value in values.items()}
    time = arrays.pop("time")
    if len(time) < 2:
        raise KinfeasError(f"{path}: has {len(time)} samples, at least 2 are needed")
    require(np.isfinite(time), "time", "is not finite")
    require(np.diff(time, prepend=-np.inf) > 0.0, "time", "does not ascend")
    require(time - time[0] <= LONGEST, "time", f"is more than {LONGEST:g} s after the first")
    for name, pose in arrays.items():
        near = np.all(np.abs(pose) <= REMOTEST, axis=1)
        require(near, name, f"is not finite or beyond {REMOTEST:,.0f} m")
        norm = np.sqrt(np.sum(pose[:, 3:] ** 2, axis=1))
        require(np.abs(norm - 1.0) <= _UNIT_TOLERANCE, name, "has no unit quaternion (xyzw)")
        pose[:, 3:] /= norm[:, np.newaxis]
    unknown = np.full((len(time), 7), np.nan)
    return Demonstration(time, **{name: arrays.get(name, unknown) for name in _POSES})
