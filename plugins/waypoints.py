"""The `waypoints` motion: a smooth path through the poses of a file.

A YAML file has a row for each waypoint, x y z qx qy qz qw in metres and a unit quaternion::

    poses:
    - [-0.3, 0.0, 0.2, 0, 0, 0, 1]
    - [-0.1, 0.0, 0.1, 0, 0, 0, 1]
    - [0.0, 0.0, 0.0, 0, 0, 0, 1]
    time: [0.0, 4.0, 6.0]  # seconds; optional

and a CSV file the same as columns, `time` being optional again::

    time,x,y,z,qx,qy,qz,qw
    0.0,-0.3,0.0,0.2,0,0,0,1
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import maximum_filter1d
from scipy.spatial.transform import RotationSpline

from kinfeas import config
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import read_csv
from kinfeas.core.quantities import Positive
from kinfeas.core.spatial import IDENTITY, POSE_COLUMNS, Array, make_pose, rotation, twist_between
from kinfeas.io.demonstrations import check_samples
from kinfeas.plugins.path import (
    FIRST,
    Frame,
    PathMotion,
    PosePath,
    even_fractions,
    in_frame,
    norm,
)  # fmt: skip

_FINE = 2000  # samples of a spline, or 20 between waypoints if these are more
_REPEATED = 1e-9  # metres and radians


class Waypoints(PathMotion):
    """A cubic spline through waypoints, in position and orientation, from any start.

    The EE first comes to the first waypoint, then passes the others to the last. Without times it
    moves about as fast as the limits allow, with `ramp` seconds of acceleration at both ends. With
    times it meets them where the limits allow.

    Args:
        file: YAML or CSV file of poses, x y z qx qy qz qw in a row, optionally with their time.
        frame: Frame of the poses: `object` is the target, `world` the world; `goal`
            moves them all so that the last lies on the target.
        ramp: Seconds from rest to full speed, and from full speed to rest, without times.
        gain: Rate at which errors decay, 1/s.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self,
        *,
        file: str,
        frame: Frame = "object",
        ramp: Positive = 1.0,
        gain: Positive = 1.0,
        max_velocity: Positive = 0.1,
        max_angular_velocity: Positive = 0.1,
    ) -> None:
        poses, time = read_waypoints(Path(file))
        if time is None:
            limits = max_velocity, max_angular_velocity
            knots, duration = _at_full_speed(Path(file), poses, limits, ramp)
        else:
            knots, duration = _in_time(poses, time)
        super().__init__(
            path=PosePath(in_frame(knots, frame, IDENTITY)),
            duration=duration,
            in_world=frame == "world",
            gain=gain,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
            first=FIRST,
        )


def _in_time(poses: Array, time: Array) -> tuple[Array, float]:
    """Return knots at even steps of time, shape (m + 1, 7), and their duration in seconds.

    The EE rests between equal waypoints: time is interpolated monotonically along the spline.
    """
    apart = _seconds(poses, (1.0, 1.0))
    reached = np.concatenate([[0.0], np.cumsum(np.where(apart > _REPEATED, apart, 0.0))])
    parameter, first = np.unique(reached, return_index=True)
    duration = float(time[-1] - time[0])
    fractions = even_fractions(duration)
    if len(parameter) == 1:
        return poses[:1].repeat(len(fractions), axis=0), duration
    at = PchipInterpolator(time, reached)(time[0] + fractions * duration)
    return _spline(parameter, poses[first])(at.clip(0.0, reached[-1])), duration


def _spline(parameter: Array, poses: Array) -> Callable[[Array], Array]:
    position = CubicSpline(parameter, poses[:, :3], bc_type="natural")
    orientation = RotationSpline(parameter, rotation(poses))
    return lambda at: make_pose(position(at), orientation(at))


def _at_full_speed(
    path: Path, poses: Array, limits: tuple[float, float], ramp: float
) -> tuple[Array, float]:
    """Return knots at even steps of time, shape (m + 1, 7), and their duration in seconds."""
    apart = _seconds(poses, limits)
    if (repeated := apart <= _REPEATED).any():
        raise KinfeasError(
            f"{path}, waypoint {int(np.argmax(repeated)) + 2}: must differ from the one before, "
            "unless the file has times"
        )
    spline = _spline(np.concatenate([[0.0], np.cumsum(apart)]), poses)
    parameter = np.linspace(0.0, apart.sum(), max(_FINE, 20 * len(poses)) + 1)
    seconds = _seconds(spline(parameter), limits)
    # Take the slowest speed nearby: otherwise the EE would jerk where a rotation reverses.
    nearby = max(1, round(min(ramp, 2.0 * parameter[-1]) / parameter[1]))
    spent = np.concatenate([[0.0], np.cumsum(maximum_filter1d(seconds, nearby))])
    ramp = min(ramp, spent[-1])
    duration = spent[-1] + ramp
    progress = _ramped(even_fractions(duration) * duration, duration, ramp)
    return spline(np.interp(progress, spent, parameter)), float(duration)


def _seconds(poses: Array, limits: tuple[float, float]) -> Array:
    """Return the durations from each pose to the next at full speed, shape (m - 1,).

    At full speed the squares of both fractions of the limits add up to one: the larger alone would
    make the EE jerk where it changes.
    """
    displacement = twist_between(poses[:-1], poses[1:], 1.0)
    return np.hypot(norm(displacement[:, :3]) / limits[0], norm(displacement[:, 3:]) / limits[1])


def _ramped(time: Array, duration: float, ramp: float) -> Array:
    """Return the seconds at full speed that cover the same distance as `time`, of the same shape.

    The speed rises evenly over the first `ramp` seconds and falls evenly over the last.
    """
    rising = np.minimum(time, ramp) ** 2 / (2.0 * ramp)
    falling = np.maximum(time - (duration - ramp), 0.0) ** 2 / (2.0 * ramp)
    return rising + np.maximum(time - ramp, 0.0) - falling


@dataclass(frozen=True)
class _Waypoints:
    poses: tuple[tuple[float, float, float, float, float, float, float], ...]
    time: tuple[float, ...] | None = None


def read_waypoints(path: Path) -> tuple[Array, Array | None]:
    """Return the poses of a YAML or CSV file, shape (m, 7), and their time, (m,), if any."""
    if path.suffix.lower() in (".yaml", ".yml"):
        data = config.load(_Waypoints, path)
        poses = np.array(data.poses, dtype=np.float64).reshape(-1, 7)
        time = None if data.time is None else np.array(data.time)
    elif path.suffix.lower() == ".csv":
        values = read_csv(path, (*POSE_COLUMNS, "time"), ("time",))
        poses, time = np.stack([values[name] for name in POSE_COLUMNS], axis=1), values.get("time")
    else:
        raise KinfeasError(f"{path}: must be a .yaml or .csv file of waypoints")
    if time is not None and len(time) != len(poses):
        raise KinfeasError(f"{path}: 'time' has {len(time)} entries for {len(poses)} waypoints")
    check_samples(path, np.arange(float(len(poses))) if time is None else time, {"pose": poses})
    poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    return poses, time
