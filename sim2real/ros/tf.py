"""The pose of one frame in another from TF messages, without tf2."""

import math
import time
from collections import defaultdict
from functools import partial
from typing import Any

import numpy as np

from kinfeas.core.spatial import IDENTITY, Array, compose
from kinfeas.sim2real.link import BaseReading
from kinfeas.sim2real.link.stamps import DRIFT, Stamps

_DEEP = 32  # frames; more of them go round in a circle


class TfTree:
    """The newest transform of each frame to its parent."""

    def __init__(self, world: str, base: str, drift: float = DRIFT) -> None:
        """Begin empty; wanted is the pose of the frame `base` in the frame `world`.

        Args:
            world: Name of the frame.
            base: Likewise.
            drift: Share by which the robot's clock may be slower than ours.
        """
        self._world, self._base = _plain(world), _plain(base)
        self._edges: dict[str, tuple[str, Array, float, float]] = {}  # parent, pose, stamp, since
        self._stamps: defaultdict[str, Stamps] = defaultdict(partial(Stamps, drift))

    def take(self, message: Any, *, static: bool = False) -> None:
        """Take a tf2_msgs/TFMessage; `static` transforms never grow old."""
        now = time.monotonic()
        for one in message.transforms:
            child, parent = _plain(one.child_frame_id), _plain(one.header.frame_id)
            p, q = one.transform.translation, one.transform.rotation
            pose = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
            stamp = one.header.stamp.to_sec()
            since = math.inf if static else now
            if stamp and not static:
                since = self._stamps[child].since(stamp, now)
            self._edges[child] = parent, pose, stamp, since

    def reading(self) -> BaseReading | None:
        """Return where the base is, as old as the oldest transform on the way; None if unknown."""
        edges, frame = dict(self._edges), self._base
        pose, oldest, stamp = IDENTITY, math.inf, None
        for _ in range(_DEEP):
            if frame == self._world:
                age = max(0.0, time.monotonic() - oldest)
                x, y, heading = planar(pose)
                return BaseReading(x, y, heading, stamp=stamp or None, age=age)
            if frame not in edges:
                return None
            frame, above, when, since = edges[frame]
            stamp = when if stamp is None else stamp
            pose, oldest = compose(above, pose), min(oldest, since)
        return None


def planar(pose: Array) -> tuple[float, float, float]:
    """Return x, y and heading of a pose, shape (7,), without its height and tilt.

    All three are NaN where its quaternion is not of unit length.
    """
    x, y, _, qx, qy, qz, qw = pose.tolist()
    if not abs(math.hypot(qx, qy, qz, qw) - 1.0) < 0.01:
        return math.nan, math.nan, math.nan
    return x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))


def _plain(frame: str) -> str:
    return frame.lstrip("/")
