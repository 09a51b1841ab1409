"""Targets that move: messages with poses or twists, checked and limited, n motions at a time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.core import spatial
from kinfeas.core.errors import check_ascending
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.quantities import REMOTEST, Positive, PositiveSeconds
from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class StreamProgress:
    """Progress of n motions at the end of a control period."""

    rows: Rows  # rows that begin a period, shape (m,)
    periods: NDArray[np.intp]  # control periods since the start of each motion, shape (n,)
    desired: Array  # desired world poses of the EEs, shape (n, 7)
    base_pose: Array  # world poses of the bases, shape (n, 7)
    time_scale: Array  # fraction of the planned motion that the last period carried out, shape (n,)
    dt: float  # control period, seconds
    motion_seconds: float  # planned motion time of a period
    delay: float = 0.0  # seconds after the end of the period at which bases have these poses


class TargetStream(Protocol):
    """Targets of the EEs of a loop, which change while it runs."""

    def start(self, desired: Array, rngs: Sequence[np.random.Generator], rows: Rows) -> None:
        """Begin new motions in m `rows`; the desired poses are those of all n, shape (n, 7)."""

    def targets(self, progress: StreamProgress) -> Array:
        """Begin the next period of some rows; return the targets of all rows in it, (n, 7)."""

    @property
    def speed(self) -> Array:
        """Speed that is asked of the EE in the next period, shape (n,), m/s."""

    @property
    def live(self) -> NDArray[np.bool_]:
        """Whether each target moves by a message that is not too old, shape (n,)."""

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state as arrays by name."""

    def restore(self, snapshot: dict[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""


@dataclass(frozen=True)
class TargetRules:
    """Limits of targets, and rules for their messages."""

    # largest age of a message, or of the last pose of a chunk, seconds; older ones are ignored, and
    # the EE comes to rest if no newer one arrives
    timeout: PositiveSeconds = 0.1
    # largest distance of a pose from the current target or, since the target may lag behind, from
    # the pose of the last message, metres; poses farther from both are ignored
    max_jump: Positive = 0.5
    max_turn: Positive = 1.6  # the same for the angle, radians
    max_velocity: Positive = 0.2  # limit of the target's velocity, m/s
    max_angular_velocity: Positive = 0.5  # the same, rad/s
    # lowest and highest z of a target, metres; a target beyond only moves back
    heights: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.heights is not None:
            check_ascending("heights", self.heights)

    @property
    def generator_limits(self) -> dict[str, float]:
        """Velocity limits as parameters of a motion generator."""
        return {
            "max_velocity": self.max_velocity,
            "max_angular_velocity": self.max_angular_velocity,
        }


RULES = ("accepted", "invalid", "late", "repeated", "jump")
"""Results of checking a message. Invalid ones have numbers that are not finite or far too large, no
unit quaternion or times that do not ascend; repeated ones are no newer than the last one."""


class TargetInbox:
    """Targets of n motions, each from the newest message of its row.

    A twist is the velocity of the target. A single pose is reached when the next one is expected,
    so that slow streams do not stutter; poses of a chunk are interpolated by their times. The
    target waits where the motion waits.

    Attributes:
        target: World poses, shape (n, 7).
        speed: Speed of each target, if the motion does not wait, shape (n,), m/s.
        live: Whether each target moves by a message that is not too old, shape (n,).
        counts: Messages by each of `RULES`, shape (n, 5).
    """

    def __init__(self, rules: TargetRules, size: int = 2) -> None:
        """Hold chunks of up to `size` poses, at least two."""
        self.rules, self._size = rules, size
        self._put_all(np.empty((0, 7)))

    def _put_all(self, target: Array) -> None:
        n = len(target)
        self.target, self._before = target.copy(), target.copy()
        self.live, self._has_poses = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        self.speed = np.zeros(n)
        self._sent, self._until = np.full((2, n), -np.inf)
        self._twist = np.zeros((n, 6))
        self._times = np.full((n, self._size), np.inf)
        self._poses = np.repeat(target[:, np.newaxis], self._size, axis=1)
        self._last_aim = target.copy()
        self.counts = np.zeros((n, len(RULES)), dtype=np.intp)

    def start(self, target: Array, rows: Rows | None = None) -> None:
        """Rest at targets (m, 7), without messages, in `rows`; by default in all, which sets n."""
        if rows is None:
            self._put_all(target)
            return
        fresh = TargetInbox(self.rules, self._size)
        fresh._put_all(target)
        for name, values in vars(fresh).items():
            if isinstance(values, np.ndarray):
                getattr(self, name)[rows] = values

    def put_twists(self, rows: Rows, now: Array, sent: Array, twist: Array) -> None:
        """Take world twists (m, 6) of m rows, sent at times (m,) and read at `now`, (m,)."""
        valid = _in_range(twist)
        good = self._admitted(rows, now, sent, sent, valid)
        self._twist[rows[good]], self._has_poses[rows[good]] = twist[good], False

    def put_poses(self, rows: Rows, now: Array, sent: Array, times: Array, poses: Array) -> None:
        """Take world poses (m, k, 7) for times (m, k); other arguments as in `put_twists`.

        The time of a single pose, k = 1, is that of its sending.
        """
        m, k, _ = poses.shape
        if not 1 <= k <= self._size:
            self.reject(rows)
            return
        numbers = np.concatenate([poses.reshape(m, -1), times], axis=1)
        valid = _in_range(numbers)
        usable = np.where(valid[:, np.newaxis, np.newaxis], poses, spatial.IDENTITY)
        length = np.linalg.norm(usable[:, :, 3:], axis=2)
        valid &= (np.abs(length - 1.0) <= spatial.UNIT).all(axis=1)
        when = np.where(valid[:, np.newaxis], times, 0.0)
        valid &= (np.diff(when, axis=1) > 0.0).all(axis=1)
        usable = np.where(valid[:, np.newaxis, np.newaxis], usable, spatial.IDENTITY)
        usable[:, :, 3:] /= np.linalg.norm(usable[:, :, 3:], axis=2, keepdims=True)
        aims = interpolated(now, when, usable)
        recent = now <= self._until[rows]
        near = self._near(self.target[rows], aims)
        near |= recent & self._has_poses[rows] & self._near(self._last_aim[rows], aims)
        dated = recent & np.isfinite(sent)
        interval = np.subtract(sent, self._sent[rows], where=dated, out=np.zeros(m))
        good = self._admitted(rows, now, sent, when[:, -1], valid, near)
        if k == 1:
            later = now + np.clip(interval, 1e-6, self.rules.timeout)
            when = np.stack([now, later], axis=1)
            usable = np.concatenate([self.target[rows, np.newaxis], usable], axis=1)
        accepted = rows[good]
        self._times[accepted], self._poses[accepted] = np.inf, usable[good, -1:]
        self._times[accepted, : when.shape[1]] = when[good]
        self._poses[accepted, : when.shape[1]] = usable[good]
        self._has_poses[accepted], self._last_aim[accepted] = True, aims[good]

    def reject(self, rows: Rows, rule: str = "invalid") -> None:
        """Count messages without usable poses or twists, or ignored by another of `RULES`."""
        self.counts[rows, RULES.index(rule)] += 1

    def wait(self, rows: Rows, time_scale: Array, desired: Array) -> None:
        """Let targets wait where motions did in their last period.

        Args:
            rows: Rows of m motions.
            time_scale: Fraction of the period that each carried out, shape (m,).
            desired: World poses of the motions now, shape (m, 7), where targets continue if none
                of the period was carried out.
        """
        waiting = time_scale != 1.0  # the other targets stay bit-identical
        if not waiting.any():
            return
        rows, time_scale = rows[waiting], time_scale[waiting]
        before = self._before[rows]
        displacement = spatial.twist_between(before, self.target[rows], 1.0)
        target = spatial.integrate(before, displacement, time_scale)
        target = np.where(time_scale[:, np.newaxis] == 0.0, desired[waiting], target)
        self.target = with_rows(self.target, rows, target)

    def advance(self, rows: Rows, now: Array, dt: float, seconds: float) -> None:
        """Move targets to the end of the next period.

        Args:
            rows: Rows of the m targets that move.
            now: Time of the period's beginning, shape (m,).
            dt: Its length, seconds.
            seconds: Its motion time, seconds.
        """
        before, live = self.target[rows], now <= self._until[rows]
        aims = interpolated(now + dt, self._times[rows], self._poses[rows])
        twist = np.where(
            self._has_poses[rows, np.newaxis],
            spatial.twist_between(before, aims, seconds),
            self._twist[rows],
        )
        twist *= (live * self._slowing(twist))[:, np.newaxis]
        target = spatial.integrate(before, twist, seconds)
        if self.rules.heights is not None:
            low, high = self.rules.heights
            z = before[:, 2]
            target[:, 2] = np.clip(target[:, 2], np.minimum(low, z), np.maximum(high, z))
        self.live[rows], self.speed[rows] = live, np.linalg.norm(twist[:, :3], axis=1)
        self._before[rows], self.target = before, with_rows(self.target, rows, target)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the state as arrays by name."""
        return {k: x.copy() for k, x in vars(self).items() if isinstance(x, np.ndarray)}

    def restore(self, snapshot: dict[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        vars(self).update({key: values.copy() for key, values in snapshot.items()})

    def _near(self, pose: Array, other: Array) -> NDArray[np.bool_]:
        metres, radians = spatial.distance(pose, other)
        return (metres <= self.rules.max_jump) & (radians <= self.rules.max_turn)

    def _admitted(
        self,
        rows: Rows,
        now: Array,
        sent: Array,
        last: Array,
        valid: NDArray[np.bool_],
        near: NDArray[np.bool_] | bool = True,
    ) -> NDArray[np.bool_]:
        """Return which messages are used, shape (m,), and note their times."""
        until = last + self.rules.timeout
        valid = valid & np.isfinite(sent)
        repeated = ~(sent > self._sent[rows])
        conditions = [~valid, ~(until >= now), repeated, ~np.broadcast_to(near, valid.shape)]
        rule = np.select(conditions, [1, 2, 3, 4], 0)
        self.counts[rows, rule] += 1
        good = rule == 0
        self._sent[rows[good]], self._until[rows[good]] = sent[good], until[good]
        return good

    def _slowing(self, twist: Array) -> Array:
        """Return the factors by which twists shrink to the limits, shape (n,)."""
        rules = self.rules
        linear = np.linalg.norm(twist[:, :3], axis=1) / rules.max_velocity
        angular = np.linalg.norm(twist[:, 3:], axis=1) / rules.max_angular_velocity
        return 1.0 / np.maximum(1.0, np.maximum(linear, angular))


def _in_range(values: Array) -> NDArray[np.bool_]:
    """Return which rows have only finite numbers up to `REMOTEST`, shape (n,)."""
    return np.max(np.abs(values), axis=1, initial=0.0) <= REMOTEST


def interpolated(now: Array, times: Array, poses: Array) -> Array:
    """Return poses at `now`, (n,), between those of chunks, (n, k, 7) at times (n, k): (n, 7)."""
    rows, last = np.arange(len(times)), times.shape[1] - 1
    passed = (times <= now[:, np.newaxis]).sum(axis=1)
    before, after = np.maximum(passed - 1, 0), np.minimum(passed, last)
    start, end = times[rows, before], times[rows, after]
    between = (after > before) & np.isfinite(end)
    span = np.subtract(end, start, where=between, out=np.ones_like(end))
    fraction = np.subtract(now, start, where=between, out=np.zeros_like(end)) / span
    left = poses[rows, before]
    return spatial.integrate(left, spatial.twist_between(left, poses[rows, after], 1.0), fraction)
