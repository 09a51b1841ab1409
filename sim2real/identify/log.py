"""What a robot was commanded and what it measured, on one clock."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, interpolated_columns, yaw
from kinfeas.io.run_log import Record
from kinfeas.robots.robot import Robot

_SHORTEST = 5.0  # s of a record that is worth a fit
_GAP = 10.0  # s between measurements; a longer gap means that a clock was set
_ON_TIME = 0.95  # fraction of the control periods of a record below which estimates are doubtful
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Log:
    """Commands in equal control periods from time zero, and measurements with their times."""

    source: str  # file, for errors
    dt: float  # control period, seconds
    twists: Array  # commanded planar velocity in world axes by period, (n, 3), m/s and rad/s
    targets: Array  # commanded joint positions by period, (n, j), continuous joints unwrapped
    base_times: Array  # times of the base poses, ascending, shape (b,), seconds
    base: Array  # position and unwrapped heading, shape (b, 3), metres and radians
    joint_times: Array  # times of the joint positions, ascending, shape (m,), seconds
    joints: Array  # joint positions, shape (m, j), continuous joints unwrapped
    ages: Array  # ages on arrival, shape (a,), seconds; empty if unknown
    arm_seconds: float  # duration of the cubic to each target, seconds, as in `Backend`


def log_of(record: Record, robot: Robot, source: str) -> Log:
    """Return the log of a run; raise KinfeasError if it is of another robot or too short."""
    names = tuple(joint.name for joint in robot.arm)
    if record.about.joints != names:
        raise KinfeasError(
            f"{source}: its joints are {', '.join(record.about.joints)}, not those of {robot.name}"
        )
    check_clock(record.time, source)
    kept = record.later
    time = record.time[kept]
    poses, joints = record.base_pose[kept], record.joint_positions[kept]
    commanded = np.concatenate([record.base_twist[kept], record.joint_targets[kept]], axis=1)
    if not np.isfinite(np.concatenate([poses, joints, commanded], axis=1)).all():
        raise KinfeasError(f"{source}: has numbers that are not finite")
    ages, has_age = record.age[kept], np.isfinite(record.age[kept])
    measured = time - np.where(has_age, ages, 0.0)
    fraction = (len(time) - 1) * record.about.dt / max(time[-1] - time[0], record.about.dt)
    if fraction < _ON_TIME:
        _log.warning(
            "%s: only %.0f %% of the control periods took place; drive again on an idle machine",
            source, 100.0 * fraction,
        )  # fmt: skip
    base = np.stack([poses[:, 0], poses[:, 1], np.unwrap(yaw(poses))], axis=1)
    # The command of a line was active since the line before.
    return make_log(
        source, robot, record.about.dt,
        (time[:-1], record.base_twist[kept][1:][:, [0, 1, 5]]),
        (time[:-1], record.joint_targets[kept][1:]),
        (measured, base), (measured, joints), ages[1:][has_age[1:]], end=float(time[-1]),
        arm_seconds=record.about.arm_seconds,
    )  # fmt: skip


def check_clock(times: Array, source: str) -> None:
    """Raise KinfeasError if times, shape (k,), go back or leave out more than a few seconds."""
    steps = np.diff(times)
    for row in np.flatnonzero(~((steps >= 0.0) & (steps <= _GAP)))[:1]:
        raise KinfeasError(
            f"{source}: its clock goes from {times[row]:.3f} s to {times[row + 1]:.3f} s; it must "
            f"ascend by at most {_GAP:g} s: cut the record there"
        )


Series = tuple[Array, Array]
"""Times, shape (k,), and values, shape (k, w)."""


def make_log(  # noqa: PLR0913, PLR0917 - the parts of a log
    source: str, robot: Robot, dt: float, twists: Series, targets: Series, base: Series,
    joints: Series, ages: Array, *, end: float, arm_seconds: float,
) -> Log:  # fmt: skip
    """Return a log; each command holds until the next one, and the last one until `end`.

    Raises KinfeasError if the log is shorter than a few seconds.
    """
    begin = min(float(twists[0][0]), float(targets[0][0])) if len(twists[0]) else end
    count = int(np.floor((end - begin) / dt + 0.5))
    if count * dt < _SHORTEST or len(base[0]) < 2 or len(joints[0]) < 2:
        raise KinfeasError(f"{source}: shorter than {_SHORTEST:g} s")
    edges = np.linspace(begin, begin + count * dt, count + 1)
    unwrapped = _unwrapped(robot, joints[1])
    aims = _unwrapped(robot, targets[1])
    # Measurements and targets of continuous joints begin in the same turn.
    turns = np.where(robot.continuous, np.round((unwrapped[0] - aims[0]) / (2.0 * np.pi)), 0.0)
    base_rows, joint_rows = _newer(base[0]), _newer(joints[0])
    return Log(
        source, dt, _means(*twists, edges), _held(targets[0], aims, edges + 0.5 * dt)[:-1]
        + turns * 2.0 * np.pi,
        base[0][base_rows] - begin, base[1][base_rows], joints[0][joint_rows] - begin,
        unwrapped[joint_rows], ages, arm_seconds,
    )  # fmt: skip


def _unwrapped(robot: Robot, positions: Array) -> Array:
    return np.where(robot.continuous, np.unwrap(positions, axis=0), positions)


def _newer(times: Array) -> NDArray[np.intp]:
    """Return the indices of measurements that are newer than all before, shape (k,)."""
    before = np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]])
    return np.flatnonzero(times > before + 1e-6)


def _means(times: Array, values: Array, edges: Array) -> Array:
    """Return means between edges (k + 1,) of values that hold from their times on, 0 before."""
    steps = np.diff(np.append(times, max(edges[-1], times[-1])))
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values * steps[:, None], 0)])
    knots = np.append(times, max(edges[-1], times[-1]) + 1e-12)
    at = interpolated_columns(edges, knots, sums)
    return np.diff(at, axis=0) / np.diff(edges)[:, np.newaxis]


def _held(times: Array, values: Array, moments: Array) -> Array:
    last = np.searchsorted(times, moments, side="right") - 1
    return values[np.maximum(last, 0)]
