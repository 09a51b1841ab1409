"""The `waypoints` motion: a smooth path through poses that a file lists."""

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d
from scipy.spatial.transform import RotationSpline

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, make_pose, rotation, twist_between
from kinfeas.plugins.limits import norm, positive
from kinfeas.plugins.path_motion import (
    PathMotion,
    checked_frame,
    even_moments,
    in_frame,
    path_through,
)
from kinfeas.plugins.phase import PhaseControl
from kinfeas.plugins.waypoint_file import read_waypoints

_FINE = 2000  # samples of a spline, or 20 between waypoints if these are more
_REPEATED = 1e-9  # metres and radians


class Waypoints(PathMotion):
    """A cubic spline through waypoints, in position and orientation, from any start.

    The hand first comes to the first waypoint, then goes through the others to the last. Without
    times it moves about as fast as the limits allow, after `ramp` seconds and until as long before
    the end. With times it keeps to them where the limits allow.

    Args:
        file: YAML or CSV file of poses, x y z qx qy qz qw in a row, and their time, if it matters.
        frame: What the poses are relative to: `object` is the target, `world` the world; `goal`
            moves them all alike, so that the last lies on the target.
        ramp: Time in seconds to full speed and from there to rest, if the file has no times.
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
        frame: str = "object",
        ramp: float = 1.0,
        gain: float = 1.0,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        placed = checked_frame(frame)
        limits = (
            positive("max_velocity", max_velocity),
            positive("max_angular_velocity", max_angular_velocity),
        )
        poses, time = read_waypoints(Path(file))
        if time is None:
            knots, duration = _at_full_speed(Path(file), poses, limits, positive("ramp", ramp))
        else:
            duration = float(time[-1] - time[0])
            knots = _Spline(time, poses).at(time[0] + even_moments(duration) * duration)
        control = PhaseControl(
            path=path_through(in_frame(knots, placed, IDENTITY)),
            duration=duration,
            gain=gain,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )
        super().__init__(control, placed == "world")


class _Spline:
    """Poses that change smoothly with the parameter, twice differentiable."""

    def __init__(self, parameter: Array, poses: Array) -> None:
        self.position = CubicSpline(parameter, poses[:, :3], bc_type="natural")
        self.orientation = RotationSpline(parameter, rotation(poses))

    def at(self, parameter: Array) -> Array:
        """Return poses, shape (m,) -> (m, 7)."""
        return make_pose(self.position(parameter), self.orientation(parameter))


def _at_full_speed(
    path: Path, poses: Array, limits: tuple[float, float], ramp: float
) -> tuple[Array, float]:
    """Return knots at even steps of time, shape (m + 1, 7), and how long they take in seconds."""
    apart = _seconds(poses, limits)
    if (repeated := apart <= _REPEATED).any():
        raise KinfeasError(
            f"{path}, waypoint {int(np.argmax(repeated)) + 2}: must differ from the one before, "
            "unless the file says the time of each"
        )
    spline = _Spline(np.concatenate([[0.0], np.cumsum(apart)]), poses)
    parameter = np.linspace(0.0, apart.sum(), max(_FINE, 20 * len(poses)) + 1)
    seconds = _seconds(spline.at(parameter), limits)
    # The pace of the slowest moment nearby: where a turn reverses, the hand would jerk instead.
    nearby = max(1, round(min(ramp, 2.0 * parameter[-1]) / parameter[1]))
    spent = np.concatenate([[0.0], np.cumsum(maximum_filter1d(seconds, nearby))])
    ramp = min(ramp, spent[-1])
    duration = spent[-1] + ramp
    progress = _ramped(even_moments(duration) * duration, duration, ramp)
    return spline.at(np.interp(progress, spent, parameter)), float(duration)


def _seconds(poses: Array, limits: tuple[float, float]) -> Array:
    """Return how long the way from each pose to the next takes at full speed, shape (m - 1,).

    At full speed the sum of the squares of both shares of the limits is one: the larger of the two
    alone would make the hand jerk where it changes.
    """
    way = twist_between(poses[:-1], poses[1:], 1.0)
    return np.hypot(norm(way[:, :3]) / limits[0], norm(way[:, 3:]) / limits[1])


def _ramped(time: Array, duration: float, ramp: float) -> Array:
    """Return the seconds at full speed that are worth the way made by `time`, of the same shape.

    The speed rises evenly over the first `ramp` seconds and falls evenly over the last.
    """
    rising = np.minimum(time, ramp) ** 2 / (2.0 * ramp)
    falling = np.maximum(time - (duration - ramp), 0.0) ** 2 / (2.0 * ramp)
    progress: Array = rising + np.maximum(time - ramp, 0.0) - falling
    return progress
