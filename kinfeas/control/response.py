"""Prediction of robots that carry out their commands late: their state when a command arrives.

Planar poses are (x, y, yaw) in the world, planar velocities (vx, vy, turn).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import LOCALISATION_SPEED, RobotState
from kinfeas.core.kernels import inlined, kernel, square
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.pose_kernels import wrapped
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array, compose, integrate, relative, yaw
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver

_POSE_SECONDS, _VELOCITY_SECONDS = 0.02, 0.4
"""Time constants with which measurements correct predicted positions and velocities."""

_JUMP, _JUMP_SPEED = 0.004, 0.1
"""Difference between measured and predicted pose that counts as a jump of the localisation: metres
or radians, plus those for each second between measurements."""

_OLDEST = 0.3  # largest age of a measurement, seconds, for which commands are kept

_TINY = 1e-9  # seconds

_LAGS = 50.0  # time constants in a period beyond which an arm counts as immediate

_MEMORY = 1.0  # time constant, seconds, with which `Lateness` forgets differences

_LEVER = 0.3  # radius at which rotations are compared with translations, metres

_ACCELERATION, _VELOCITY = 3, 6
"""First columns of acceleration and velocity in the motion of a base, shape (9,): the velocity that
its controller asks for, the acceleration of that, and the velocity of the base, all planar. They
are in one array, since compilers see that its parts do not overlap."""


class Lateness(NamedTuple):
    """Differences of a base from its model, and their regression for `core.metrics.lateness`."""

    behind: Array  # displacement by which it is behind its model, with fading memory, shape (3,)
    faster: Array  # change of its velocity, with the same memory, shape (3,)
    sums: Array  # sums over time of behind * faster and of faster squared, shape (2,)


class BaseEstimate(NamedTuple):
    """Estimated state of a base; shape (3,) unless stated."""

    pose: Array  # predicted planar pose
    jump: Array  # part of a jump of the localisation that is yet to be followed
    measured: Array  # last measurement of the planar pose
    motion: Array  # motion at the time of that measurement, shape (9,)
    correction: Array  # part of its velocity that is due to corrections by measurements
    lateness: Lateness


def _base_of(row: Array) -> BaseEstimate:
    """Return views of a base, shape (29, ...), by name."""
    lateness = Lateness(row[21:24], row[24:27], row[27:29])
    return BaseEstimate(row[0:3], row[3:6], row[6:9], row[9:18], row[18:21], lateness)


_base = kernel(_base_of)


class BaseResponse:
    """Displacements of bases that carry out their commands late and within limits."""

    def __init__(self, response: ResponseModel) -> None:
        limits = (
            response.acceleration, response.rotation_acceleration,
            response.jerk, response.rotation_jerk,
        )  # fmt: skip
        self.limits = np.array(
            [response.base_lag, *(math.inf if limit is None else limit for limit in limits)]
        )
        self._arm_lag = response.arm_lag

    def lead(self, dt: float) -> float:
        """Return the seconds by which joint targets lead, so that a lagging arm is on time."""
        lags = min(dt / self._arm_lag, _LAGS) if self._arm_lag > 0.0 else _LAGS
        return dt / math.expm1(lags)

    def reached(self, base_pose: Array, motion: Array, twist: Array, dt: float) -> Array:
        """Return the world poses after `dt` seconds plus the lead of the arm under a world twist.

        Poses have the shape (n, 7), motions (n, 9), twists (n, 6), m/s and rad/s.
        """
        moved = np.zeros((len(twist), 6))
        _displace(motion, twist, dt, self.lead(dt), self.limits, moved)
        return integrate(base_pose, moved, 1.0)


class Predictor:
    """States of n robots at the time at which the next command takes effect.

    Measured poses are carried forward by the response of the robots to commands that were sent but
    have not yet taken effect. Measurements correct the prediction; it follows jumps of the
    localisation gradually.

    Attributes:
        delay: Seconds until a command takes effect.
        base: Response of the bases.
        motion: Motions of the bases when the next command takes effect, shape (n, 9).
    """

    motion: Array
    _base: Array
    _age: Array
    _moved: Array
    _joints: Array
    _twists: Array
    _targets: Array
    _desired: Array

    def __init__(self, response: ResponseModel, solver: IkSolver, dt: float) -> None:
        self.delay, self.dt, self.base = response.command_latency, dt, BaseResponse(response)
        self._response, self._chain = response, solver.chain
        self._slots = math.ceil((self.delay + _OLDEST) / dt) + 2
        self._timing = np.array([self.delay, dt, response.arm_lag])
        # A copy, because numba compiles kernels again for read-only arrays.
        self._max_velocity = np.array(solver.robot.max_joint_velocity)
        self._continuous = np.array(solver.robot.continuous)

    def start(self, robots: RobotState, rows: Rows | None = None) -> RobotState:
        """Begin with robots at rest in some rows, or in all of n, and return the state of all n."""
        n, joints = len(robots.base_pose), robots.joint_positions
        ee = compose(robots.base_pose, forward(self._chain, joints))
        base, planar = np.zeros((n, 29)), _planar(robots.base_pose).T
        estimate = _base_of(base.T)
        estimate.pose[:], estimate.measured[:] = planar, planar
        fresh = {
            "_base": base,
            "_age": self._ages(robots),
            "_moved": np.zeros((n, 6)),
            "_joints": joints,
            "_twists": np.zeros((n, self._slots, 3)),
            "_targets": np.repeat(joints[:, np.newaxis], self._slots, axis=1),
            "_desired": np.repeat(ee[:, np.newaxis, :3], self._slots, axis=1),
            "motion": np.zeros((n, 9)),
        }
        for name, values in fresh.items():
            if rows is not None:
                values = with_rows(getattr(self, name), rows, values[rows])
            setattr(self, name, values)
        return self._carried_forward(robots)

    @property
    def due(self) -> Array:
        """Positions due now, which were desired `delay` seconds ago, metres, shape (n, 3)."""
        before, fraction = divmod(self.delay / self.dt, 1.0)
        newer, older = self._desired[:, -1 - int(before)], self._desired[:, -2 - int(before)]
        return newer + (older - newer) * fraction

    def command(self, twist: Array, targets: Array, desired: Array) -> None:
        """Record the commands of a period and the EE poses that are desired at its end.

        World twists have the shape (n, 6), joint targets (n, j), poses (n, 7).
        """
        self._desired = np.concatenate([self._desired[:, 1:], desired[:, np.newaxis, :3]], axis=1)
        planar = twist[:, np.newaxis, _PLANAR]
        self._twists = np.concatenate([self._twists[:, 1:], planar], axis=1)
        self._targets = np.concatenate([self._targets[:, 1:], targets[:, np.newaxis]], axis=1)

    def predict(self, robots: RobotState) -> RobotState:
        """Return the state at which the next command takes effect, from that after a period."""
        age, base = self._ages(robots), self._base.copy()
        motion, moved = np.empty((len(age), 9)), np.zeros((len(age), 6))
        joints = robots.joint_positions.copy()
        _predict(
            _planar(robots.base_pose), age, self._age, self._twists, self._targets, self._timing,
            self.base.limits, self._max_velocity, self._continuous, base, motion, joints, moved,
        )  # fmt: skip
        self._base, self._age, self.motion = base, age, motion
        self._moved, self._joints = moved, joints
        return self._carried_forward(robots)

    @property
    def sums(self) -> Array:
        """Sums over the episodes so far, from which `lateness` follows, shape (n, 2)."""
        return _base_of(self._base.T).lateness.sums.T

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state of all n robots by name."""
        return {f"{_PREFIX}{name}": getattr(self, name) for name in _STATE}

    def restore(self, snapshot: Mapping[str, NDArray[Any]], robots: RobotState) -> RobotState:
        """Continue from a snapshot and the measured state; return the predicted one."""
        for name in _STATE:
            setattr(self, name, snapshot[f"{_PREFIX}{name}"].copy())
        return self._carried_forward(robots)

    def _carried_forward(self, robots: RobotState) -> RobotState:
        joints, ee = self._joints, robots.ee_in_base
        if ee is not None:
            offset = relative(ee, forward(self._chain, robots.joint_positions))
            ee = compose(forward(self._chain, joints), offset)
        return replace(
            robots,
            base_pose=integrate(robots.base_pose, self._moved, 1.0),
            joint_positions=joints,
            ee_in_base=ee,
            true_state=robots.true_state or robots,
        )

    def _ages(self, robots: RobotState) -> Array:
        if robots.age is None:
            return np.full(len(robots.base_pose), self._response.sensor_latency)
        return np.clip(robots.age, 0.0, _OLDEST)


_PREFIX = "predictor."
_STATE = "_base", "_age", "_moved", "_joints", "_twists", "_targets", "_desired", "motion"
_PLANAR = np.array([0, 1, 5])


def _planar(pose: Array) -> Array:
    """Return x, y and yaw of poses, shape (n, 7) -> (n, 3)."""
    return np.concatenate([pose[:, :2], yaw(pose)[:, np.newaxis]], axis=1)


@inlined
def _shortened(x, y, longest):
    """Return a planar vector of at most a length."""
    length = math.sqrt(square(x) + square(y))
    scale = longest / length if length > longest else 1.0
    return x * scale, y * scale


@inlined
def _accelerated(x, y, before_x, before_y, most, jerk, seconds):
    """Return the feasible acceleration for the target (x, y), as adapter `acceleration_limit`."""
    if jerk == math.inf:
        return _shortened(x, y, most)
    length, half = math.sqrt(square(x) + square(y)), 0.5 * jerk * seconds
    # Reducing an acceleration a to zero in steps changes the velocity by a (a / jerk + step) / 2.
    fading = math.sqrt(square(half) + 2.0 * jerk * length * seconds) - half
    x, y = _shortened(x, y, min(most, fading))
    x, y = _shortened(x - before_x, y - before_y, jerk * seconds)
    return _shortened(before_x + x, before_y + y, most)


@inlined
def advance(motion, twist, seconds, limits, moved):
    """Advance a motion, shape (9,), under a planar twist, (3,); add its displacement, (3,).

    `limits` are lag, limits of linear and angular acceleration, and of linear and angular jerk.
    """
    if seconds < _TINY:
        return
    lag, most, turning, jerk, twisting = limits
    x, y, turn = (
        (twist[0] - motion[0]) / seconds,
        (twist[1] - motion[1]) / seconds,
        (twist[2] - motion[2]) / seconds,
    )
    a, v = _ACCELERATION, _VELOCITY
    motion[a], motion[a + 1] = _accelerated(x, y, motion[a], motion[a + 1], most, jerk, seconds)
    motion[a + 2], _ = _accelerated(turn, 0.0, motion[a + 2], 0.0, turning, twisting, seconds)
    decay = math.exp(-seconds / lag) if lag > 0.0 else 0.0
    for i in range(3):
        motion[i] += motion[a + i] * seconds
        behind = motion[v + i] - motion[i]
        motion[v + i] = motion[i] + behind * decay
        moved[i] += motion[i] * seconds + behind * lag * (1.0 - decay)


@kernel
def _displace(motions, twists, dt, lead, limits, moved):
    """Write the displacements, shape (n, 6), of bases in `dt` and then `lead` seconds."""
    motion, planar, twist = np.empty(9), np.empty(3), np.empty(3)
    for i in range(len(moved)):
        motion[:], planar[:] = motions[i], 0.0
        twist[0], twist[1], twist[2] = twists[i, 0], twists[i, 1], twists[i, 5]
        advance(motion, twist, dt, limits, planar)
        advance(motion, twist, lead, limits, planar)
        moved[i, 0], moved[i, 1], moved[i, 5] = planar[0], planar[1], planar[2]


@kernel
def _travel(begin, end, twists, timing, limits, motion, moved):
    """Advance a motion from `begin` to `end`, seconds from now, under the commands then active."""
    delay, dt, slots = timing[0], timing[1], len(twists)
    for k in range(slots):
        # Command k was sent (slots - k) periods ago; there is none before the first.
        start = begin if k == 0 else max(begin, delay - (slots - k) * dt)
        advance(motion, twists[k], min(end, delay - (slots - k - 1) * dt) - start, limits, moved)


@kernel
def _predict(
    measured, ages, ages_before, twists, targets, timing, limits, max_velocity, continuous,
    bases, motions, joints, moved,
):  # fmt: skip
    """Update bases, shape (n, 29), with measurements; write motions, joints and displacements.

    Measurements have the shape (n, 3), motions (n, 9), displacements (n, 6). `timing` are the delay
    of commands, the control period and the lag of the arms, seconds.
    """
    delay, dt, arm_lag = timing
    slots, planar = targets.shape[1], np.empty(3)
    for i in range(len(measured)):
        begin, now = -ages_before[i] - dt, -ages[i]
        base, motion = _base(bases[i]), motions[i]
        motion[:] = base.motion
        if now - begin > _TINY:
            planar[:] = 0.0
            _travel(begin, now, twists[i], timing, limits, motion, planar)
            _compare(base, motion, planar, measured[i], now - begin, limits[0])
            _correct(base, motion, planar, measured[i], now - begin)
            base.motion[:] = motion
        planar[0], planar[1] = base.pose[0] - measured[i, 0], base.pose[1] - measured[i, 1]
        planar[2] = wrapped(base.pose[2] - measured[i, 2])
        _travel(now, delay, twists[i], timing, limits, motion, planar)
        moved[i, 0], moved[i, 1], moved[i, 5] = planar[0], planar[1], planar[2]
        for k in range(slots):
            start = max(now, delay - (slots - k) * dt) if k else now
            seconds = min(delay, delay - (slots - k - 1) * dt) - start
            if seconds < _TINY:
                continue
            fraction = 1.0 - math.exp(-seconds / arm_lag) if arm_lag > 0.0 else 1.0
            for j in range(joints.shape[1]):
                displacement = targets[i, k, j] - joints[i, j]
                if continuous[j]:
                    displacement = wrapped(displacement)
                largest = max_velocity[j] * seconds
                joints[i, j] += min(max(displacement * fraction, -largest), largest)
                if continuous[j]:
                    joints[i, j] = wrapped(joints[i, j])


@inlined
def _compare(base, motion, planar, measured, seconds, lag):
    """Compare a measured displacement of a base with the predicted one, shape (3,).

    A base that is late by t seconds falls behind by t times the change of its velocity.
    """
    last, before, correction = base.measured, base.motion, base.correction
    behind, faster, sums = base.lateness
    error_x, error_y = measured[0] - last[0] - planar[0], measured[1] - last[1] - planar[1]
    error = error_x, error_y, wrapped(measured[2] - last[2] - planar[2])
    largest = max(math.sqrt(square(error_x) + square(error_y)), abs(error[2]))
    decay = math.exp(-seconds / lag) if lag > 0.0 else 0.0
    forgotten = math.exp(-seconds / _MEMORY)
    for k in range(3):
        change = motion[_VELOCITY + k] - before[_VELOCITY + k] + correction[k] * (1.0 - decay)
        missing = -error[k] - correction[k] * lag * (1.0 - decay)
        if largest > _JUMP + _JUMP_SPEED * seconds:
            missing = 0.0
        behind[k] = behind[k] * forgotten + missing
        faster[k] = faster[k] * forgotten + change
        correction[k] *= decay
        weight = square(_LEVER) if k == 2 else 1.0
        sums[0] += behind[k] * faster[k] * weight
        sums[1] += square(faster[k]) * weight


@inlined
def _correct(base, motion, planar, measured, seconds):
    """Correct a base and its motion after a predicted displacement, shape (3,)."""
    pose, jump, last, correction = base.pose, base.jump, base.measured, base.correction
    for k in range(3):
        last[k] = measured[k]
        pose[k] += planar[k]
        planar[k] = measured[k] - jump[k] - pose[k]
    planar[2] = wrapped(planar[2])
    error = max(math.sqrt(square(planar[0]) + square(planar[1])), abs(planar[2]))
    if error > _JUMP + _JUMP_SPEED * seconds:
        for k in range(3):
            jump[k] += planar[k]
            planar[k] = 0.0
    position_gain = 1.0 - math.exp(-seconds / _POSE_SECONDS)
    velocity_gain = (1.0 - math.exp(-seconds / _VELOCITY_SECONDS)) / seconds
    longest = LOCALISATION_SPEED * seconds
    x, y = _shortened(jump[0], jump[1], longest)
    followed = x, y, min(max(jump[2], -longest), longest)
    for k in range(3):
        jump[k] -= followed[k]
        pose[k] += position_gain * planar[k] + followed[k]
        correction[k] += velocity_gain * planar[k]
        motion[_VELOCITY + k] += velocity_gain * planar[k]
