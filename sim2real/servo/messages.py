"""Messages of a target source: the frames that they name, and when they were sent."""

import math
from bisect import bisect_right
from collections import deque
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from kinfeas.control.targets import interpolated
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import REMOTEST
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.link.measurements import DRIFT

WORLD = ("", "world", "map", "odom")
"""Names of the world frame."""

_HISTORY = 256  # control periods whose poses are known

_MESSAGES, _SECONDS = 5, 0.5
"""Least number of messages, and seconds between the first and the last, that show another offset of
the clocks."""

_PATIENCE, _FACTOR = 10.0, 10.0
"""Seconds in place of `_SECONDS` if a slow queue may be the reason: at least, and per second of
delay."""


class Message(NamedTuple):
    """A twist (6,), or poses (k, 7 or 9) at times (k,); None if they are no arrays of numbers.

    `arrival` is of our clock; `stamp`, `times` and `observed` are of the sender's, or without a
    stamp of ours.
    """

    arrival: float
    stamp: float | None
    values: Array | None
    times: Array | None = None
    frame: str = ""
    observed: float | None = None
    keep: float = 0.0
    is_twist: bool = False


class Frames:
    """World poses of the base and the EE in the last control periods, by the frames' names.

    Attributes:
        names: Names of frames that are not empty.
    """

    def __init__(self, robot: Robot) -> None:
        self._names = (robot.base.frame, robot.ee_frame)
        self.names = (*WORLD[1:], *self._names)
        self._history: dict[str, deque[tuple[float, Array]]] = {
            name: deque(maxlen=_HISTORY) for name in self._names
        }

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lstrip("/") in ("", *self.names)

    def append(self, time: float, base_pose: Array, ee_pose: Array, delay: float = 0.0) -> None:
        """Take the EE pose (7,) at a time in seconds, and the base pose `delay` seconds later."""
        base, ee = self._history.values()
        if delay and not base:
            base.append((time, base_pose))  # at rest
        base.append((time + delay, base_pose))
        ee.append((time, ee_pose))

    def at(self, name: str, time: float) -> Array | None:
        """Return the world pose (7,) of a known frame at a time; None before the history."""
        name = name.lstrip("/")
        if name in WORLD:
            return spatial.IDENTITY
        history = self._history[name]
        after = bisect_right(history, time, key=itemgetter(0))
        if after == 0:
            return None
        pair = history[after - 1], history[min(after, len(history) - 1)]
        times, frames = (np.array([values]) for values in zip(*pair, strict=True))
        return interpolated(np.array([time]), times, frames)[0]


def chunk_in_world(
    values: Array, times: Array | None, frame: Array, when: float, offset: float
) -> tuple[Array, Array] | None:
    """Return times (1, k), plus `offset`, and world poses (1, k, 7); None for invalid values.

    `frame` is the world pose of the frame of the values, `when` the time of a single pose (7,).
    """
    if times is None and values.shape == (7,):
        values, times, offset = values[np.newaxis], np.array([when]), 0.0
    if times is not None and values.shape == (len(times), 9):
        try:
            values = spatial.from_columns(values)
        except KinfeasError:
            return None
    if times is None or times.shape != (len(values),) or values.shape != (len(times), 7):
        return None
    quaternions = np.clip(values[:, 3:], -2.0, 2.0)  # no overflow
    unit = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) <= spatial.UNIT
    if frame is not spatial.IDENTITY and unit.all():
        values = spatial.compose(frame, values)
    return (times + offset)[np.newaxis], values[np.newaxis]


def why_invalid(times: Array, poses: Array, most: int) -> str:
    """Return why poses (k, 7) at times (k,) are no valid chunk of at most `most` poses."""
    if not 1 <= len(poses) <= most:
        return f"{len(poses)} poses, not 1 to {most}"
    if not (np.diff(times) > 0.0).all():
        return "times that do not ascend"
    if not np.abs(times).max() <= REMOTEST:
        return f"times of another clock, beyond {REMOTEST:g} s"
    return "a quaternion whose length is not 1, or numbers that are too large"


class SenderClock:
    """Estimates when stamped messages were sent, by our clock.

    The offset of the clocks is the smallest difference of arrival and stamp so far; it grows by
    `DRIFT`, since the sender's clock may be slow. A message with another difference waited in a
    queue or has a wrong stamp, and leaves the offset as it is. But if `_MESSAGES` in a row agree on
    another offset for long enough, that one is taken. Long enough are `_SECONDS` if no queue can be
    the reason, since they are early or older than a message before; otherwise `_FACTOR` times their
    delay, and at least `_PATIENCE`.
    """

    def __init__(self, tolerance: float) -> None:
        """Start without a message; those later by more than `tolerance`, seconds, are in doubt."""
        self._tolerance = tolerance
        self._offset, self._newest = math.inf, -math.inf
        self._count, self._began, self._delay, self._least = 0, 0.0, 0.0, 0.0
        self._no_queue = False

    def sent(self, stamp: float, arrival: float) -> float | None:
        """Return when a message was sent, seconds of our clock and at most `arrival`.

        Its `stamp` is of the sender's clock. Returns None if it would be later than `arrival` by
        more than half of the tolerance.
        """
        delay = arrival - stamp
        if self._newest == -math.inf:
            self._offset, self._newest = delay, stamp
        offset = self._offset + DRIFT * max(0.0, stamp - self._newest)
        late = delay - offset
        if -0.5 * self._tolerance <= late <= self._tolerance:
            self._offset, self._newest = min(delay, offset), max(stamp, self._newest)
            self._count = 0
        elif self._agreed(stamp, arrival, late):
            self._offset, self._newest, self._count = self._least, stamp, 0
        elif not late > 0.0:
            return None
        return min(arrival, stamp + self._offset)

    def _agreed(self, stamp: float, arrival: float, late: float) -> bool:
        """Return whether messages in doubt, this being the last, agree on another offset."""
        delay, no_queue = arrival - stamp, late < 0.0 or stamp < self._newest
        agrees = abs(delay - self._delay) <= self._tolerance and no_queue == self._no_queue
        if self._count == 0 or not agrees:
            self._count, self._began, self._delay, self._least = 0, arrival, delay, delay
            self._no_queue = no_queue
        self._count, self._least = self._count + 1, min(self._least, delay)
        seconds = _SECONDS if no_queue else max(_PATIENCE, _FACTOR * late)
        return self._count >= _MESSAGES and arrival - self._began >= seconds
