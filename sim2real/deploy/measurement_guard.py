"""Whether what was measured of a robot can be believed."""

from typing import NoReturn

import numpy as np

from kinfeas.core import spatial
from kinfeas.core.backend import RobotState
from kinfeas.core.checks import array_fault
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.link.fault import Fault, beyond

_UNIT = 1e-2  # by which the length of a measured quaternion may be off


class MeasurementGuard:
    """Looks at one measurement after the other."""

    def __init__(self, robot: Robot, guards: Guards, *, needs_age: bool) -> None:
        """Begin without a measurement.

        Args:
            robot: Who is measured.
            guards: What is believed.
            needs_age: Whether a measurement must say how old it is.
        """
        self._robot, self._guards, self._needs_age = robot, guards, needs_age
        self._lower, self._upper = robot.joint_limits
        self._start: Array | None = None
        self._last: Array = np.empty(7)

    def begin(self, state: RobotState) -> None:
        """Take a measurement as the start.

        Raises:
            Fault: If it cannot be believed.
        """
        self._start = None
        self.check(state, 0.0)
        self._start = self._last

    def check(self, state: RobotState, elapsed: float) -> None:
        """Do nothing if a measurement can be believed.

        Args:
            state: Of one robot.
            elapsed: Seconds since the command went out that led here from the last one.

        Raises:
            Fault: If it cannot.
        """
        self._check_form(state)
        self._check_age(state)
        pose = state.base_pose[0]
        self._check_pose(pose)
        if self._start is not None:
            self._check_way(pose, elapsed)
        self._check_joints(state.joint_positions[0])
        self._last = pose.copy()

    def _check_form(self, state: RobotState) -> None:
        shapes = state.base_pose.shape, state.joint_positions.shape
        wanted = (1, 7), (1, len(self._robot.arm))
        if shapes != wanted:
            _refuse(f"measurements have the shapes {shapes}, those of this robot are {wanted}")
        if state.age is not None and array_fault(state.age, (1,), finite=False):
            _refuse("the age of the measurements is no array of one number")
        if not np.isfinite(state.base_pose).all():
            _refuse("the measured base pose is not finite")
        if state.ee_in_base is not None and not np.isfinite(state.ee_in_base).all():
            _refuse("the measured EE pose is not finite")
        bad = np.flatnonzero(~np.isfinite(state.joint_positions[0]))
        if bad.size:
            _refuse(f"the measured position of joint {self._name(bad[0])} is not finite")

    def _check_age(self, state: RobotState) -> None:
        if state.age is None:
            if self._needs_age:
                _refuse("the backend does not say how old its measurements are")
            return
        age, guards = float(np.max(state.age)), self._guards
        if not np.isfinite(state.age).all():
            _refuse("the age of the measurements is not finite")
        if age > guards.max_age:
            old = beyond(age, guards.max_age)
            _refuse(f"the newest measurement is {old} s old, at most {guards.max_age:g} s is")
        early = -float(np.min(state.age))
        if early > guards.max_clock_skew:
            ahead = beyond(early, guards.max_clock_skew)
            _refuse(f"a measurement comes from {ahead} s in the future")

    def _check_pose(self, pose: Array) -> None:
        if abs(float(np.linalg.norm(pose[3:])) - 1.0) > _UNIT:
            _refuse("the orientation of the measured base pose is not a unit quaternion")
        tilt, most = 2.0 * float(np.hypot(pose[3], pose[4])), self._guards.max_tilt
        if tilt > most:
            _refuse(f"the base leans by {beyond(tilt, most)} rad, at most {most:g} rad is")

    def _check_way(self, pose: Array, elapsed: float) -> None:
        guards, base = self._guards, self._robot.base
        assert self._start is not None
        away, most = float(np.hypot(*(pose - self._start)[:2])), guards.max_distance
        if away > most:
            _refuse(f"the base is {beyond(away, most)} m from its start, at most {most:g} m is")
        metres, radians = map(float, spatial.distance(self._last, pose))
        farthest = guards.pose_jump + base.max_velocity * elapsed
        if metres > farthest:
            _refuse(f"the measured base pose jumped by {beyond(metres, farthest)} m")
        widest = guards.heading_jump + base.max_rotation * elapsed
        if radians > widest:
            _refuse(f"the measured base pose jumped by {beyond(radians, widest)} rad")

    def _check_joints(self, joints: Array) -> None:
        outside = np.maximum(self._lower - joints, joints - self._upper)
        worst = int(np.argmax(outside))
        most = self._guards.joint_tolerance
        if outside[worst] > most:
            off = beyond(float(outside[worst]), most)
            _refuse(
                f"joint {self._name(worst)} is measured {off} beyond its limits, at most {most:g} "
                "is"
            )

    def _name(self, joint: int) -> str:
        return self._robot.arm[joint].name


def _refuse(reason: str) -> NoReturn:
    raise Fault(f"{reason} allowed" if reason.endswith(" is") else reason)
