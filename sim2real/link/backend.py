"""A robot behind a link as a backend of the loop: the same for every transport."""

import math
import time
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import Grip, RobotState
from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError
from kinfeas.core.spatial import Array, wrap
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.deploy.rate import Rate
from kinfeas.sim2real.link import Link
from kinfeas.sim2real.link.drive_limits import to_drive
from kinfeas.sim2real.link.fault import Fault, beyond
from kinfeas.sim2real.link.inbox import Inbox
from kinfeas.sim2real.link.stamps import DRIFT

_POLL = 0.02  # s, between two looks at whether all is there
_OFF = 0.02  # rad or m by which a joint may stand beside where the kinematics have it


class LinkBackend:
    """One robot that moves by its own clock: a `RealTimeBackend` with a gripper.

    Attributes:
        robot: Who moves.
        link: How it is reached.
        rate: Waits for the end of each control period and keeps count of misses; None until
            the first step.
    """

    def __init__(  # noqa: PLR0913 - a file sets them by name
        self,
        robot: Robot,
        link: Link,
        *,
        names: dict[str, str] | None = None,
        seconds: float = 0.1,
        patience: float = 5.0,
        stale: float = 0.2,
        drift: float = DRIFT,
    ) -> None:
        """Connect nothing yet: `reset` does.

        Args:
            robot: Robot at the other end.
            link: Transport; it is opened by the first `reset` and closed by `close`.
            names: The robot's names of arm joints that are named otherwise in its URDF.
            seconds: In which the arm shall reach each target; longer where a joint needs longer.
            patience: For how many seconds `reset` waits for the first measurements.
            stale: Seconds after a measurement was handed out, or control periods if those are
                longer, beyond which a command that follows from it is not sent any more.
            drift: Share by which the robot's clock may be slower than ours; measurements that
                fall behind more than that have waited in a queue, and are as old as that.

        Raises:
            KinfeasError: If a duration is not above 0 and finite, the drift not in [0, 1), or a
                name is unknown.
        """
        for name, value in (("seconds", seconds), ("patience", patience), ("stale", stale)):
            if not 0.0 < value < math.inf:
                raise KinfeasError(f"{name} must be above 0 s and finite, not {value:g}")
        if not 0.0 <= drift < 1.0:
            raise KinfeasError(f"drift must be in [0, 1), not {drift:g}")
        self.robot, self.link = robot, link
        self.rate: Rate | None = None
        self._names = robot_names(robot, names or {})
        self._inbox = Inbox(robot, self._names, drift)
        self._seconds, self._patience, self._stale = seconds, patience, stale
        self._opened, self._handed_out = False, math.nan
        self._joint_speed = robot.max_joint_velocity

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Wait until robot and link are there and return the robot's state where it stands.

        Raises:
            KinfeasError: If something stays silent, naming it, or the robot's other joints stand
                where its kinematics do not have them.
        """
        self._inbox.forget()
        if not self._opened:
            self.link.open(self._inbox.readings())
            self._opened = True
        end = time.monotonic() + self._patience
        while not self._inbox.wait(_POLL) or self.link.waits_for() is not None:
            self.link.check()
            if time.monotonic() > end:
                raise KinfeasError(self._silence())
        self._check_other_joints()
        self.rate = None
        return self.read()

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send a command, wait for the end of the control period and return what is newest.

        Raises:
            KinfeasError: If the command is not one for one robot.
            Fault: If it is not finite or stale, or the link is broken; the base is commanded to
                zero before.
        """
        if base_twist.shape != (1, 6) or joint_targets.shape != (1, len(self.robot.arm)):
            raise KinfeasError(f"a link leads to one robot of {len(self.robot.arm)} arm joints")
        if not (np.isfinite(base_twist).all() and np.isfinite(joint_targets).all()):
            self.stop()
            raise Fault("twists and joint positions must be finite numbers")
        rate = self._pace(dt)
        velocity = to_drive(self.robot.base, self._newest().base_pose[0], base_twist[0], dt)
        if self.robot.base.drive == "differential":
            velocity[1] = 0.0
        self._check_fresh(dt)
        self.link.drive(velocity)
        # Whoever was held up within the last line takes it back at once.
        self._check_fresh(dt)
        self._send(joint_targets[0])
        rate.wait()
        return self.read()

    def read(self) -> RobotState:
        """Return the newest measurement, with its age.

        Raises:
            Fault: If the link is broken or the measurements are useless; the base is commanded to
                zero before.
        """
        state = self._newest()
        self._handed_out = time.monotonic()
        return state

    def _newest(self) -> RobotState:
        try:
            self.link.check()
            if self._inbox.fault is not None:
                raise Fault(self._inbox.fault)
        except Fault:
            self.stop()
            raise
        if any(self._inbox.lacks()):
            raise KinfeasError("the robot has not been measured yet: reset waits for that")
        return self._inbox.state()

    def _check_fresh(self, dt: float) -> None:
        late = time.monotonic() - self._handed_out
        latest = max(self._stale, dt)
        if late > latest:
            self.stop()
            shown = beyond(late, latest)
            raise Fault(f"the command comes {shown} s after the measurement that it is made of")

    def stop(self) -> None:
        """Command the base to zero and the arm to stay where it was last measured.

        The arm is commanded even if commanding the base raises, which is raised afterwards.
        """
        if not self._opened:
            return
        try:
            self.link.drive(np.zeros(3))
        except PLUGIN_ERRORS:
            with suppress(*PLUGIN_ERRORS):
                self._hold()
            raise
        self._hold()

    def limit_arm(self, velocity: Array) -> None:
        """Let no joint go faster from now on, nor than it can; shape (j,), rad/s or m/s."""
        self._joint_speed = np.minimum(velocity, self.robot.max_joint_velocity)

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Begin to close or to open the gripper."""
        if env_ids.size:
            self.link.grip(grip)

    def close(self) -> None:
        """Stop the robot and let go of the link; it may be called twice."""
        if self._opened:
            try:
                self.stop()
            finally:
                self.link.close()
                self._opened = False

    def _hold(self) -> None:
        """Command the arm to stay where it was last measured, if it was."""
        if not any(self._inbox.lacks()):
            self._send(self._inbox.raw())

    def _send(self, targets: Array) -> None:
        """Send the arm to joint positions, shape (j,)."""
        raw = self._inbox.raw()
        # A robot counts the turns of a continuous joint: the shorter way from where it is.
        way = np.where(self.robot.continuous, wrap(targets - raw), targets - raw)
        # An arm that was held up has a longer way, and no joint shall be faster than it may.
        seconds = max(self._seconds, float(np.max(np.abs(way) / self._joint_speed)))
        names = self._names.values()
        self.link.move(dict(zip(names, (raw + way).tolist(), strict=True)), seconds)

    def _pace(self, dt: float) -> Rate:
        if self.rate is None or self.rate.dt != dt:
            self.rate = Rate(dt)
            self.rate.wait()  # which sets it going
        return self.rate

    def _silence(self) -> str:
        """Return which part of the robot is silent."""
        base, joints = self._inbox.lacks()
        within = f"within {self._patience:g} s"
        if base:
            return f"no pose of the base came from {self.link.base_source} {within}; {_CHECK}"
        if len(joints) == len(self.robot.arm):
            return f"no joint positions came from {self.link.joint_source} {within}; {_CHECK}"
        if joints:
            known = ", ".join(sorted(self._inbox.heard()))
            lacking = ", ".join(joints)
            return f"{self.link.joint_source} says nothing of {lacking}; it has {known}"
        return f"nobody listens to {self.link.waits_for()} {within}; {_CHECK}"

    def _check_other_joints(self) -> None:
        """Check that what IK takes for fixed stands where IK has it."""
        heard = self._inbox.heard()
        for joint in self.robot.urdf.path_to(self.robot.ee_frame):
            assumed = self.robot.fixed_joints.get(joint.name)
            measured = heard.get(joint.name)
            if assumed is None or measured is None:
                continue
            if not abs(measured - assumed) <= _OFF:
                raise KinfeasError(
                    f"{joint.name} stands at {measured:.3f}, but the kinematics of "
                    f"{self.robot.name} have it at {assumed:.3f}: move it there first"
                )


_CHECK = "is the robot on, its controllers running, and do the names in the topics file fit?"


def robot_names(robot: Robot, names: dict[str, str]) -> dict[str, str]:
    """Return the robot's own name of each arm joint, in order.

    Args:
        robot: Robot with the arm.
        names: Its names of the joints that are named otherwise in its URDF.

    Raises:
        KinfeasError: If one of them is no arm joint.
    """
    known = [joint.name for joint in robot.arm]
    for name in names:
        if name not in known:
            raise KinfeasError(
                f"there is no arm joint {name!r} to rename; known are {', '.join(known)}"
            )
    return {name: names.get(name, name) for name in known}
