"""Waypoints as files: poses, and the moments at which the hand is there, if these matter.

A YAML file holds a row for each waypoint, x y z qx qy qz qw in metres and a unit quaternion::

    poses:
    - [-0.3, 0.0, 0.2, 0, 0, 0, 1]
    - [-0.1, 0.0, 0.1, 0, 0, 0, 1]
    - [0.0, 0.0, 0.0, 0, 0, 0, 1]
    time: [0.0, 4.0, 6.0]  # seconds; may be left out

and a CSV file the same as columns, `time` again where it is wanted::

    time,x,y,z,qx,qy,qz,qw
    0.0,-0.3,0.0,0.2,0,0,0,1
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinfeas import config
from kinfeas.config.quantities import LONGEST
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.io.csv_table import read_csv
from kinfeas.plugins.model import Number

_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
_NOT_UNIT = 1e-3  # how far the norm of a quaternion may be from 1; rounding by hand makes 2e-4
_FARTHEST = 1000.0  # metres


@dataclass(frozen=True)
class _Waypoints:
    """What a YAML file holds."""

    poses: tuple[tuple[Number, Number, Number, Number, Number, Number, Number], ...]
    time: tuple[float, ...] | None = None


def read_waypoints(path: Path) -> tuple[Array, Array | None]:
    """Return the poses of a YAML or CSV file, shape (m, 7), m >= 2, and their time, (m,), if any.

    Raises:
        KinfeasError: If the file cannot be read, is not of the form above, has fewer than two
            waypoints, a quaternion is not unit or the time does not ascend.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        poses, time = _read_yaml(path)
    elif path.suffix.lower() == ".csv":
        poses, time = _read_csv(path)
    else:
        raise KinfeasError(f"{path}: must be a .yaml or .csv file of waypoints")
    if len(poses) < 2:
        raise KinfeasError(f"{path}: has {len(poses)} waypoints, at least 2 are needed")
    if time is not None and len(time) != len(poses):
        raise KinfeasError(f"{path}: 'time' has {len(time)} entries for {len(poses)} waypoints")
    _check(path, poses, time)
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return poses, time


def _read_yaml(path: Path) -> tuple[Array, Array | None]:
    data = config.load(_Waypoints, path)
    poses = np.array(data.poses, dtype=np.float64).reshape(-1, 7)
    return poses, None if data.time is None else np.array(data.time)


def _read_csv(path: Path) -> tuple[Array, Array | None]:
    def choose(header: Sequence[str]) -> list[str]:
        return [*_COLUMNS, *(["time"] if "time" in header else [])]

    values = read_csv(path, choose).values
    return values[:, :7], values[:, 7] if values.shape[1] > 7 else None


def _check(path: Path, poses: Array, time: Array | None) -> None:
    """Raise on the first waypoint that cannot be."""
    near = np.isfinite(poses).all(axis=1) & (np.abs(poses) <= _FARTHEST).all(axis=1)
    unit = np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1.0) <= _NOT_UNIT
    rules = [
        (near, f"must be of finite numbers, at most {_FARTHEST:g}"),
        (unit, "must have a unit quaternion (xyzw)"),
    ]
    if time is not None:
        later = np.diff(time, prepend=-np.inf) > 0.0
        rules.append((np.isfinite(time) & later, "must be later than the one before"))
        soon = np.abs(time - time[0]) <= LONGEST
        rules.append((soon, f"must be at most {LONGEST:g} s later than the first"))
    for holds, rule in rules:
        if not holds.all():
            raise KinfeasError(f"{path}, waypoint {int(np.argmin(holds)) + 1}: {rule}")
