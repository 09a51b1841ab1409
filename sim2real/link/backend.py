"""A robot behind a link as a backend of the loop, the same for every transport."""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import Grip, RealTimeBackend, RobotState, Scan
from kinfeas.core.errors import PLUGIN_ERRORS, Fault, KinfeasError
from kinfeas.core.quantities import PositiveSeconds
from kinfeas.core.spatial import Array
from kinfeas.kinematics.drive import base_velocity
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.sim2real.link import Link
from kinfeas.sim2real.link.measurements import DRIFT, Drift, Inbox
from kinfeas.sim2real.link.rate import Clock, Rate

_POLL = 0.02  # s between checks of the connection during `reset`
_OFFSET = 0.02  # rad or m that a joint outside the arm may deviate from the kinematic model
_CHECK = "is the robot on, its controllers running, and do the names in the topics file fit?"


class LinkBackend(RealTimeBackend):
    """A robot that moves in real time, with a gripper, and a scanner if the link has scan sources.

    Commands are sent as they are: `kinfeas.sim2real.deploy.guards` limits them and checks their
    age.

    Attributes:
        rate: Ends the control periods; None before the first step.
    """

    def __init__(  # noqa: PLR0913 - keyword parameters of a YAML file
        self,
        robot: Robot,
        link: Link,
        *,
        names: dict[str, str] | None = None,
        seconds: PositiveSeconds = 0.1,
        timeout: PositiveSeconds = 5.0,
        drift: Drift = DRIFT,
        clock: Clock | None = None,
    ) -> None:
        """Prepare a backend; the first `reset` connects, and `close` closes the link.

        Args:
            robot: Robot model.
            link: Transport.
            names: The robot's own names of joints, where its URDF has others.
            seconds: Duration of the motion to each arm target; longer if a joint needs longer.
            timeout: Seconds that `reset` waits for the first measurements.
            drift: Fraction by which the robot's clock may be slower than ours, 0 to 0.99.
            clock: The system's clocks by default.
        """
        self.robot, self.link = robot, link
        self.rate: Rate | None = None
        self.gripper, self.response = self, robot.response
        self._clock = clock or Clock()
        self._aliases = names or {}
        self._names = {joint.name: self._aliases.get(joint.name, joint.name) for joint in robot.arm}
        self._inbox = Inbox(robot, self._names, drift, self._clock.monotonic)
        self.arm_seconds, self._timeout = seconds, timeout
        self._joint_speed = robot.max_joint_velocity
        # Arm positions, measured before the last command, and its targets; both with turns.
        self._last: tuple[Array, Array] | None = None
        self._opened = False
        self._scan_sources: Any = getattr(link, "scan_sources", None)
        self.scanner = self if self._scan_sources else None

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Connect, wait for measurements and return the current state; nothing is moved.

        Raises:
            KinfeasError: If a source or receiver is missing, or a joint outside the arm deviates
                from the kinematic model.
        """
        self._inbox.forget(scans=not self._opened)
        if not self._opened:
            self.link.open(self._inbox.readings())
            self._opened = True
        self._wait(self._missing)
        self._check_other_joints()
        self.rate = self._last = None
        return self.read()

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send a command, wait for the end of the control period and `read` the newest state."""
        if self.rate is None or self.rate.dt != dt:
            self.rate = Rate(dt, self._clock)
            self.rate.prepare = self.prepare
            self.rate.wait()
        # Of the state that the caller has checked; a newer one may jump.
        arm, pose = self._inbox.arm, self._inbox.base_pose
        self.read()  # raises if the link is broken or the sensors have failed
        velocity = base_velocity(self.robot.base, pose, base_twist, dt)[0]
        if self.robot.base.drive == "differential":
            velocity[1] = 0.0
        self.link.drive(velocity)
        # Continuous joints are measured with their turns and take the shorter way.
        target = arm + joint_displacement(self.robot, arm, joint_targets[0])
        self._last = arm, target
        self._move(target, arm)
        self.rate.wait()
        return self.read()

    def read(self) -> RobotState:
        """Return the newest state; raise Fault if the link is broken or the sensors have failed."""
        self.link.check()
        if self._inbox.fault is not None:
            raise Fault(self._inbox.fault)
        if any(self._inbox.missing()):
            raise KinfeasError("there is no measurement of the robot before reset")
        return self._inbox.state()

    def stop(self) -> None:
        """Command the base to zero and the arm to where it was measured before the last command.

        Later measurements may be wrong. Before the first command the arm is not commanded; later it
        is, even if commanding the base raises.
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
        """Limit the arm's joint velocities, shape (j,), rad/s or m/s, below the robot's own."""
        self._joint_speed = np.minimum(velocity, self.robot.max_joint_velocity)

    def silent_source(self, seconds: float) -> str:
        """Return which source sent nothing valid for some seconds; empty if none is silent."""
        base, joints = self._inbox.missing(seconds)
        if base:
            return f"no pose of the base came from {self.link.base_source}"
        if len(joints) == len(self.robot.arm):
            return f"no valid joint positions came from {self.link.joint_source}"
        present = ", ".join(sorted(self._inbox.positions().keys() - set(joints)))
        missing, source = ", ".join(joints), self.link.joint_source
        return missing and f"no position of {missing} came from {source}, but of {present}"

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Close or open the gripper."""
        if env_ids.size:
            self.link.grip(grip)

    def close(self) -> None:
        """Stop the robot and disconnect; it may be called twice."""
        if self._opened:
            try:
                self.stop()
            finally:
                self.link.close()
                self._opened = False

    def scan(self) -> Scan:
        """Return the newest scan; raise KinfeasError if none comes.

        The first call waits for it, and not `reset`, since most policies need no scan.
        """
        self._wait(self._missing_scan)
        return self._inbox.scan()

    def _wait(self, missing: Callable[[], str]) -> None:
        """Wait until `missing` returns no text; raise KinfeasError with it after the timeout."""
        end = self._clock.monotonic() + self._timeout
        while reason := missing():
            self.link.check()
            if self._clock.monotonic() > end:
                raise KinfeasError(reason)
            self._clock.sleep(_POLL)

    def _missing_scan(self) -> str:
        missing = self._scan_sources.keys() - self._inbox.scans()
        topics = " or ".join(sorted(self._scan_sources[kind] for kind in missing))
        return topics and (
            f"no scan came from {topics} within {self._timeout:g} s: is the sensor on, and do the "
            "names in the topics file fit? Without the sensor, remove its key from the file"
        )

    def _hold(self) -> None:
        if self._last is not None:
            # The arm is somewhere between these two, also if it was stopped before.
            self._move(np.clip(self._last[0], *self.robot.joint_limits), *self._last)

    def _move(self, target: Array, *starts: Array) -> None:
        """Send the arm to joint positions, shape (j,), at a limited velocity from any start."""
        # The peak velocity of a cubic from rest is 1.5 times its mean.
        longest = 1.5 * np.abs(target - np.array(starts)) / self._joint_speed
        seconds = max(self.arm_seconds, float(np.max(longest)))
        self.link.move(dict(zip(self._names.values(), target.tolist(), strict=True)), seconds)

    def _missing(self) -> str:
        within = f"within {self._timeout:g} s; {_CHECK}"
        if reason := self.silent_source(math.inf):
            return f"{reason} {within}"
        command = self.link.waits_for()
        return "" if command is None else f"{command} has no subscriber {within}"

    def _check_other_joints(self) -> None:
        """Check the joints between base and EE that the kinematic model holds fixed."""
        positions = self._inbox.positions()
        for joint in self.robot.urdf.path_to(self.robot.ee_frame):
            fixed = self.robot.fixed_joints.get(joint.name)
            measured = positions.get(self._aliases.get(joint.name, joint.name))
            if fixed is not None and measured is not None and not abs(measured - fixed) <= _OFFSET:
                raise KinfeasError(
                    f"move joint {joint.name} from {measured:.3f} to {fixed:.3f}, as in the model"
                )
