"""Whether what was measured of a robot can be believed."""

from typing import NoReturn

import numpy as np

from kinfeas import spatial
from kinfeas.backend import RobotState
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.fault import Fault
from kinfeas.sim2real.guard_config import Guards
from kinfeas.spatial import Array

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
            _refuse(f"the newest measurement is {age:.2f} s old, at most {guards.max_age:g} s is")
        if float(np.min(state.age)) < -guards.clock_jump:
            _refuse(f"a measurement comes from {-np.min(state.age):.2f} s in the future")

    def _check_pose(self, pose: Array) -> None:
        if abs(float(np.linalg.norm(pose[3:])) - 1.0) > _UNIT:
            _refuse("the orientation of the measured base pose is not a unit quaternion")
        tilt = 2.0 * float(np.hypot(pose[3], pose[4]))
        if tilt > self._guards.max_tilt:
            _refuse(f"the base leans by {tilt:.2f} rad, at most {self._guards.max_tilt:g} rad is")

    def _check_way(self, pose: Array, elapsed: float) -> None:
        guards, base = self._guards, self._robot.base
        assert self._start is not None
        away = float(np.hypot(*(pose - self._start)[:2]))
        if away > guards.max_distance:
            _refuse(
                f"the base is {away:.1f} m from its start, at most {guards.max_distance:g} m is"
            )
        metres, radians = spatial.distance(self._last, pose)
        if metres > guards.pose_jump + base.max_velocity * elapsed:
            _refuse(f"the measured base pose jumped by {float(metres):.2f} m")
        if radians > guards.heading_jump + base.max_rotation * elapsed:
            _refuse(f"the measured base pose jumped by {float(radians):.2f} rad")

    def _check_joints(self, joints: Array) -> None:
        beyond = np.maximum(self._lower - joints, joints - self._upper)
        worst = int(np.argmax(beyond))
        if beyond[worst] > self._guards.joint_tolerance:
            _refuse(
                f"joint {self._name(worst)} is measured {beyond[worst]:.2f} beyond its limits, at "
                f"most {self._guards.joint_tolerance:g} is"
            )

    def _name(self, joint: int) -> str:
        return self._robot.arm[joint].name


def _refuse(reason: str) -> NoReturn:
    raise Fault(f"{reason} allowed" if reason.endswith(" is") else reason)
