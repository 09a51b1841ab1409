"""The newest measurements of a robot, merged from messages and with their ages by our own clock."""

import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from kinfeas.core.backend import RobotState, Scan
from kinfeas.core.spatial import planar_pose, wrap
from kinfeas.kinematics.drive import world_twist
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.link import BaseReading, JointReading, Readings
from kinfeas.sim2real.link.scans import (
    CostmapReading,
    LaserReading,
    combined,
    costmap_ranges,
    laser_ranges,
)

Drift = Annotated[float, Interval(ge=0.0, le=0.99)]
"""Fraction by which a robot's clock may be slow."""

DRIFT = 1e-3
"""Default: twice the rate at which NTP slews a clock at most."""

_REORDERED = 0.1
"""Seconds by which a stamp may precede the last one: messages may overtake each other."""


class TransportDelay:
    """Estimates when stamped measurements were sent, by our clock.

    The smallest difference of arrival and stamp so far is taken as the offset of the two clocks. A
    message that waited in a queue, or is sent again, was sent at its stamp plus this offset.
    Neither a constant offset nor a stamp that jumps ahead makes a measurement old. A robot's clock
    that is slower than `drift` allows shows as a growing delay.

    Attributes:
        last: Newest stamp, seconds.
    """

    def __init__(self, drift: float = DRIFT) -> None:
        """Start without a message; the robot's clock may be slow by the fraction `drift`, < 1."""
        self.last, self._offset = -math.inf, math.inf
        self._lag = drift / (1.0 - drift)  # per second of the robot's clock

    def sent(self, stamp: float, arrival: float) -> float:
        """Return when a measurement was sent, seconds of our clock and at most `arrival`.

        Its `stamp` is of the robot's clock.
        """
        slower = self._lag * (stamp - self.last)
        self.last, self._offset = stamp, min(arrival - stamp, self._offset + slower)
        return min(arrival, stamp + self._offset)


class Inbox:
    """Merges measurements that arrive from other threads, in any order and in parts.

    Each part, the base and every joint, has an age of its own on the monotonic clock. Setting a
    clock, here or on the robot, does not make old measurements new; nor does a driver that repeats
    its last message or a queue that falls behind. Measurements that are not finite or older than
    the last one of the same part are dropped.

    Attributes:
        fault: Why measurements cannot be used any more, until `forget`: a number that is not finite
            or a stamp that went back by far. None otherwise.
        arm: Positions of the arm joints in the last `state`, with the turns of continuous joints,
            shape (j,).
        base_pose: World pose of the base in the last `state`, shape (1, 7).
    """

    def __init__(
        self,
        robot: Robot,
        names: dict[str, str],
        drift: float = DRIFT,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start empty; `names` are the robot's own of its arm joints, `now` is a clock."""
        self.fault: str | None = None
        self.arm, self.base_pose = np.empty(0), np.empty((1, 7))
        self._robot, self._now = robot, now
        self._names = [names[joint.name] for joint in robot.arm]
        self._lock = threading.RLock()
        self._base: tuple[BaseReading, float] | None = None
        self._joints: dict[str, tuple[float, float, float]] = {}  # position, velocity, sent
        self._scans: dict[Any, tuple[Any, float]] = {}  # reading and time of sending, by its type
        self._delays: defaultdict[str, TransportDelay] = defaultdict(partial(TransportDelay, drift))

    def readings(self) -> Readings:
        """Return the callbacks for a transport."""
        return Readings(self._take_base, self._take_joints, self._take_scan)

    def forget(self, *, scans: bool = True) -> None:
        """Drop everything, or all except scans."""
        with self._lock:
            self._base = self.fault = None
            if scans:
                self._scans.clear()
            self._joints.clear()
            self._delays.clear()

    def missing(self, seconds: float = math.inf) -> tuple[bool, list[str]]:
        """Return whether the base pose is missing, and the names of the missing arm joints.

        Measurements older than `seconds` count as missing.
        """
        since = self._now() - seconds
        with self._lock:
            sent = {name: joint[2] for name, joint in self._joints.items()}
            joints = [name for name in self._names if not sent.get(name, -math.inf) > since]
            return self._base is None or self._base[1] < since, joints

    def positions(self) -> dict[str, float]:
        """Return the newest positions of all joints by name, of the arm and others."""
        with self._lock:
            return {name: values[0] for name, values in self._joints.items()}

    def state(self) -> RobotState:
        """Return the newest state as a batch of one; nothing may be missing."""
        with self._lock:
            assert self._base is not None
            (base, sent), joints = self._base, [self._joints[name] for name in self._names]
        position, velocity, joint_sent = np.array(joints).T
        pose = planar_pose(*np.array([[base.x], [base.y], [base.yaw]]))
        self.arm, self.base_pose = position, pose
        twist = None
        if base.velocity is not None:
            twist = world_twist(self._robot.base, pose, base.velocity[np.newaxis], 0.0)
        return RobotState(
            base_pose=pose,
            joint_positions=np.where(self._robot.continuous, wrap(position), position)[np.newaxis],
            base_twist=twist,
            joint_velocities=velocity[np.newaxis] if np.isfinite(velocity).all() else None,
            age=np.array([self._now() - min(sent, joint_sent.min())]),
        )

    def scans(self) -> set[type[LaserReading] | type[CostmapReading]]:
        """Return the types of scans that have arrived."""
        with self._lock:
            return set(self._scans)

    def scan(self) -> Scan:
        """Return the newest scan; a base pose, and a laser or costmap, must have arrived."""
        with self._lock:
            assert self._base is not None
            base, scans = self._base[0], dict(self._scans)
        low = high = None
        if LaserReading in scans:
            low = laser_ranges(scans[LaserReading][0])
        if CostmapReading in scans:
            high = costmap_ranges(scans[CostmapReading][0], (base.x, base.y, base.yaw))
        return combined(low, high, self._now() - min(sent for _, sent in scans.values()))

    def _take_base(self, reading: BaseReading) -> None:
        now = self._now()
        with self._lock:
            if not np.isfinite([reading.x, reading.y, reading.yaw, reading.age]).all():
                self._fail(reading.fault or "the measured base pose is not finite")
            elif (sent := self._sent("the base", reading.stamp, now)) is not None:
                self._base = reading, min(sent, now - reading.age)

    def _take_joints(self, reading: JointReading) -> None:
        now = self._now()
        with self._lock:
            for name, position in reading.positions.items():
                if math.isfinite(position):
                    if (sent := self._sent(name, reading.stamp, now)) is not None:
                        velocity = reading.velocities.get(name, np.nan)
                        self._joints[name] = position, velocity, sent
                elif name in self._names:
                    self._fail(f"the measured position of joint {name} is not finite")

    def _take_scan(self, reading: LaserReading | CostmapReading) -> None:
        part, now = "laser" if isinstance(reading, LaserReading) else "costmap", self._now()
        with self._lock:
            if (sent := self._sent(f"the {part}", reading.stamp, now)) is not None:
                self._scans[type(reading)] = reading, sent

    def _fail(self, reason: str) -> None:
        self.fault = self.fault or reason

    def _sent(self, part: str, stamp: float | None, arrival: float) -> float | None:
        """Return when a measurement of a part was sent; None if it is to be dropped."""
        if stamp is None:
            return arrival
        if not math.isfinite(stamp):
            self._fail(f"a stamp of {part} is not finite")
            return None
        delay = self._delays[part]
        if stamp < delay.last - _REORDERED:
            self._fail(
                f"the stamps of {part} went back by {delay.last - stamp:.2f} s: the robot's clock "
                "was set, or two robots report"
            )
        return None if stamp < delay.last else delay.sent(stamp, arrival)
