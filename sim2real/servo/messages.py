"""Messages of a target source, and the frames that they name."""

from bisect import bisect_right
from collections import deque
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from kinfeas.control.targets import interpolated
from kinfeas.core import spatial
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot

WORLD = ("", "world", "map", "odom")
"""Names of the world frame."""

_HISTORY = 256  # control periods whose poses are known


class Message(NamedTuple):
    """Twist (6,) or poses (k, 7 or 9) for times (k,), or neither; seconds of sender and ours."""

    arrival: float
    stamp: float | None
    values: Array | None
    times: Array | None = None
    frame: str = ""
    observed: float | None = None
    keep: float = 0.0


class Frames:
    """World poses of the base and the EE in the last control periods, by the frames' names."""

    def __init__(self, robot: Robot) -> None:
        self._names = (robot.base.frame, robot.ee_frame)
        self._history: deque[tuple[float, Array, Array]] = deque(maxlen=_HISTORY)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lstrip("/") in (*WORLD, *self._names)

    def clear(self) -> None:
        """Forget all poses."""
        self._history.clear()

    def append(self, time: float, base_pose: Array, ee_pose: Array) -> None:
        """Take the poses (7,) at a time in seconds."""
        self._history.append((time, base_pose, ee_pose))

    def at(self, name: str, time: float) -> Array | None:
        """Return the world pose (7,) of a known frame at a time; None before the history."""
        name = name.lstrip("/")
        if name in WORLD:
            return spatial.IDENTITY
        after = bisect_right(self._history, time, key=itemgetter(0))
        if after == 0:
            return None
        pair = self._history[after - 1], self._history[min(after, len(self._history) - 1)]
        times, *frames = (np.array([values]) for values in zip(*pair, strict=True))
        return interpolated(np.array([time]), times, frames[self._names.index(name)])[0]


def chunk_in_world(
    values: Array, times: Array | None, frame: Array, when: float, offset: float
) -> tuple[Array, Array] | None:
    """Return times (1, k) plus an offset and world poses (1, k, 7); None for other values."""
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
