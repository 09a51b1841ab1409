"""What has arrived from a robot: the newest of each part, with its age by our own clock."""

import math
import threading
import time
from collections import defaultdict
from functools import partial

import numpy as np

from kinfeas.core.backend import RobotState
from kinfeas.core.spatial import Array, planar_pose, wrap
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.link import BaseReading, JointReading, Readings
from kinfeas.sim2real.link.drive_limits import from_drive
from kinfeas.sim2real.link.stamps import DRIFT, Stamps

BACKWARDS = 0.1
"""Seconds that a stamp may lie before the last one: messages may overtake each other."""


class Inbox:
    """Merges measurements that arrive from other threads, in any order and in parts.

    Ages count on the monotonic clock: from the arrival, or from before it where stamps say that a
    measurement was longer on its way than others of the same part. So no setting of a clock, here
    or on the robot, makes old data look new, nor does a queue that falls behind. What bears the
    last stamp of the same part is as old as that: a driver that hangs may repeat it for ever. What
    lies before it is not taken, and if it lies far before, the robot's clock was set back, or a
    driver began anew with another clock, and `fault` says so until `forget`. Nor is what is not
    finite: what is in here can be calculated with, whatever arrives meanwhile.

    Attributes:
        fault: What makes the measurements useless from now on; None while there is no such thing.
    """

    def __init__(self, robot: Robot, names: dict[str, str], drift: float = DRIFT) -> None:
        """Begin empty.

        Args:
            robot: Whose arm joints are looked for.
            names: The robot's name of each arm joint.
            drift: Share by which the robot's clock may be slower than ours.
        """
        self.fault: str | None = None
        self._robot = robot
        self._names = [names[joint.name] for joint in robot.arm]
        self._changed = threading.Condition()
        self._base: tuple[BaseReading, float] | None = None
        self._joints: dict[str, tuple[float, float, float]] = {}  # position, velocity, since
        self._stamps: defaultdict[str, Stamps] = defaultdict(partial(Stamps, drift))

    def readings(self) -> Readings:
        """Return what a transport hands measurements to."""
        return Readings(self._take_base, self._take_joints)

    def forget(self) -> None:
        """Begin empty again."""
        with self._changed:
            self._base, self.fault = None, None
            self._joints.clear()
            self._stamps.clear()

    def wait(self, seconds: float) -> bool:
        """Return whether everything has arrived, after `seconds` at most."""
        with self._changed:
            return self._changed.wait_for(self._complete, seconds)

    def lacks(self) -> tuple[bool, list[str]]:
        """Return whether the base's pose never came, and the names of the joints that did not."""
        with self._changed:
            return self._base is None, [name for name in self._names if name not in self._joints]

    def heard(self) -> dict[str, float]:
        """Return the newest positions of all joints, also those that are not of the arm."""
        with self._changed:
            return {name: values[0] for name, values in self._joints.items()}

    def raw(self) -> Array:
        """Return the arm's positions as the robot counts them, without wrapping, shape (j,)."""
        with self._changed:
            return np.array([self._joints[name][0] for name in self._names])

    def state(self) -> RobotState:
        """Return the newest measurement of everything, as a batch of one; all must have come."""
        with self._changed:
            assert self._base is not None
            (base, since), joints = self._base, [self._joints[name] for name in self._names]
        position, velocity, joint_since = np.array(joints).T
        pose = planar_pose(*np.array([[base.x], [base.y], [base.yaw]]))
        twist = None
        if base.velocity is not None:
            twist = from_drive(self._robot.base, pose[0], base.velocity, 0.0)[np.newaxis]
        oldest = min(since, float(joint_since.min()))
        return RobotState(
            base_pose=pose,
            joint_positions=np.where(self._robot.continuous, wrap(position), position)[np.newaxis],
            base_twist=twist,
            joint_velocities=velocity[np.newaxis] if np.isfinite(velocity).all() else None,
            age=np.array([time.monotonic() - oldest]),
        )

    def _complete(self) -> bool:
        return self._base is not None and all(name in self._joints for name in self._names)

    def _take_base(self, reading: BaseReading) -> None:
        with self._changed:
            if not np.isfinite([reading.x, reading.y, reading.yaw, reading.age]).all():
                self._refuse("the measured base pose is not finite")
                return
            now = time.monotonic()
            since = self._since("the base", reading.stamp, now)
            if since is not None:
                self._base = reading, min(since, now - reading.age)
                self._changed.notify_all()

    def _take_joints(self, reading: JointReading) -> None:
        now = time.monotonic()
        with self._changed:
            for name, position in reading.positions.items():
                if not math.isfinite(position):
                    if name in self._names:
                        self._refuse(f"the measured position of joint {name} is not finite")
                    continue
                since = self._since(name, reading.stamp, now)
                if since is not None:
                    velocity = reading.velocities.get(name, np.nan)
                    self._joints[name] = position, velocity, since
            self._changed.notify_all()

    def _refuse(self, reason: str) -> None:
        """Note the first of what makes the measurements useless."""
        if self.fault is None:
            self.fault = reason

    def _since(self, part: str, stamp: float | None, arrival: float) -> float | None:
        """Return since when a measurement of a part is on its way; None if it is not taken."""
        if stamp is None:
            return arrival
        if not math.isfinite(stamp):
            self._refuse(f"a stamp of {part} is not finite")
            return None
        stamps = self._stamps[part]
        if stamp < stamps.last:
            if stamps.last - stamp > BACKWARDS:
                self._refuse(
                    f"the stamps of {part} went back by {stamps.last - stamp:.2f} s: was the "
                    "robot's clock set, or do two robots report?"
                )
            return None
        return stamps.since(stamp, arrival)
