"""The guards of commands: the last thing before the robot, within all adapters."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import (
    ArmLimited,
    Backend,
    Grip,
    RealTimeBackend,
    RobotState,
)
from kinfeas.core.checks import check_state
from kinfeas.core.errors import plugin_note
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.passing import Passing
from kinfeas.sim2real.link.drive_limits import DriveLimits, arm_go, from_drive, to_drive
from kinfeas.sim2real.link.fault import Fault, beyond


class CommandGuard(Passing):
    """A backend of one robot that is sent nothing beyond its limits, whoever commands it.

    Once it was stopped it commands nothing any more.

    Attributes:
        robot: Who is moved.
        base_twist: World twist that was sent last, shape (1, 6).
        joint_targets: Arm joints that were sent last, shape (1, j).
        held: Why the arm was not sent on in the last step, or nothing.
        stopped: Whether the base was commanded to zero for good, as it is before a reset.
        steps: How many commands were carried out.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        guards: Guards,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Put the guards right around what moves the robot.

        Args:
            backend: What moves the robot.
            robot: Who is moved.
            guards: What is allowed.
            clock: What tells the time, in seconds; it never goes backwards.
        """
        super().__init__(backend)
        self.robot, self._guards, self._clock = robot, guards, clock
        self._real_time = backend if isinstance(backend, RealTimeBackend) else None
        self._arm_limited = backend if isinstance(backend, ArmLimited) else None
        self._name = f"backend {type(backend).__name__}"
        self._limits = _limits(robot, guards)
        self._joint_speed = guards.joint_speed * robot.max_joint_velocity
        self._velocity, self._dt = np.zeros(3), 0.0
        self._state, self._measured = RobotState(np.empty((0, 7)), np.empty((0, 0))), np.nan
        self.base_twist, self.joint_targets = np.zeros((1, 6)), np.empty((1, 0))
        self.held, self.stopped, self.steps = "", True, 0

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Begin anew; shapes as in `Backend`.

        Raises:
            KinfeasError: If a backend from outside fails, or returns no state.
        """
        if self._arm_limited is not None:
            with plugin_note(self._name):
                self._arm_limited.limit_arm(self._joint_speed)
        with plugin_note(self._name):
            state = self.backend.reset(base_pose, joint_positions, env_ids)
        self._take("reset", state)
        self.base_twist, self.joint_targets = np.zeros((1, 6)), state.joint_positions.copy()
        self._velocity = np.zeros(3)
        self.held, self.stopped = "", False
        return state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send what is allowed of a command and return what was measured; shapes as in `Backend`.

        Raises:
            KinfeasError: If the backend returns no state.
            Fault: If the command is none, or made of too old a measurement, or the robot was
                stopped.
        """
        if self.stopped:
            raise Fault("the base was stopped")
        check_command(self.robot, base_twist, joint_targets)
        base, pose = self.robot.base, self._state.base_pose[0]
        velocity = to_drive(base, pose, base_twist[0], dt)
        self._velocity, self._dt = self._limits.clamp(velocity, self._velocity, dt), dt
        twist = from_drive(base, pose, self._velocity, dt)[np.newaxis]
        targets = self._arm(joint_targets[0], dt)[np.newaxis]
        # Both are made of a measurement, too, which may still be on its way to who judges it.
        check_command(self.robot, twist, targets)
        self._check_fresh()
        self.base_twist, self.joint_targets = twist, targets
        # Copies, for others' code may write into them.
        state = self._take("step", self.backend.step(twist.copy(), targets.copy(), dt))
        self.steps += 1
        return state

    def look(self) -> RobotState | None:
        """Return what is measured of a robot that moves by its own clock; None of any other.

        Raises:
            KinfeasError: If a backend from outside fails, or returns no state.
        """
        if self._real_time is None:
            return None
        with plugin_note(self._name):
            state = self._real_time.read()
        check_state(state, 1, len(self.robot.arm), f"{self._name}: read", finite=False)
        return state

    def seed(self, seeds: NDArray[np.uint64], env_ids: NDArray[np.intp]) -> None:
        """Pass on to a backend that draws random numbers."""
        with plugin_note(self._name):
            super().seed(seeds, env_ids)

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Pass on to a backend that has grippers.

        Raises:
            Fault: If the robot was stopped.
        """
        if self.stopped:
            raise Fault("the base was stopped")
        super().grip(grip, env_ids)

    def stop(self) -> None:
        """Command the base to zero, the arm to stay; it may be called at any time, and twice."""
        drove, self.stopped = not self.stopped, True
        self.base_twist, self._velocity = np.zeros((1, 6)), np.zeros(3)
        if self._real_time is not None:
            self._real_time.stop()
        elif drove and self._dt > 0.0:  # before the first step nothing moves
            self.backend.step(self.base_twist, self.joint_targets, self._dt)

    def close(self) -> None:
        """Close the backend; it may be called twice.

        Raises:
            KinfeasError: If a backend from outside fails.
        """
        with plugin_note(self._name):
            self.backend.close()

    def _take(self, method: str, answer: RobotState) -> RobotState:
        """Return what was measured just now, if it is a state."""
        check_state(answer, 1, len(self.robot.arm), f"{self._name}: {method}", finite=False)
        self._state, self._measured = answer, self._clock()
        return self._state

    def _check_fresh(self) -> None:
        """Raise if a robot that moves meanwhile was measured too long ago."""
        if self._real_time is not None:
            check_age(self._state, self._clock() - self._measured, self._guards.max_age)

    def _arm(self, targets: Array, dt: float) -> Array:
        """Return how far toward targets, shape (j,), the arm is sent on."""
        before, robot = self.joint_targets[0], self.robot
        move = joint_displacement(robot, before, targets)
        lag = (
            np.abs(joint_displacement(robot, self._state.joint_positions[0], before))
            / self._joint_speed
        )
        self.held = ""
        if np.abs(move).max() > self._guards.joint_jump:
            self.held = "the arm's target is too far away"
        elif (
            not lag.max() <= self._guards.max_tracking_delay
        ):  # which is no number where an arm is lost
            self.held = f"joint {robot.arm[int(lag.argmax())].name} does not follow"
        if self.held:
            return before
        share = np.max(np.abs(move) / (self._joint_speed * dt), initial=1.0)
        return arm_go(robot, before, move / share)


def check_command(robot: Robot, base_twist: Array, joint_targets: Array) -> None:
    """Do nothing if this is a command for one robot.

    Raises:
        Fault: If it has other shapes or is not finite.
    """
    shapes, wanted = (base_twist.shape, joint_targets.shape), ((1, 6), (1, len(robot.arm)))
    if shapes != wanted:
        raise Fault(f"the command has the shapes {shapes}, robot {robot.name} {wanted}")
    if not np.isfinite(base_twist).all():
        raise Fault("the command for the base is not finite")
    if not np.isfinite(joint_targets).all():
        raise Fault("the command for the arm is not finite")


def check_age(state: RobotState, elapsed: float, most: float) -> None:
    """Do nothing if a command may still be made of a measurement.

    Args:
        state: What was measured, of one robot.
        elapsed: Seconds since it was.
        most: Seconds that it may be old.

    Raises:
        Fault: If it is older.
    """
    old = elapsed + (0.0 if state.age is None else float(np.max(state.age)))
    if not old <= most:
        raise Fault(
            f"the command is made of a measurement {beyond(old, most)} s old, at most {most:g} s "
            "is allowed"
        )


def _limits(robot: Robot, guards: Guards) -> DriveLimits:
    """Return the limits of a robot's base, or those of the guards where they are lower."""
    own = DriveLimits.of(robot.base)

    def lower(name: str) -> float:
        most: float | None = getattr(guards, name)
        return getattr(own, name) if most is None else min(most, getattr(own, name))

    names = ("max_linear_velocity", "max_angular_velocity", "acceleration", "rotation_acceleration")
    return replace(own, **{name: lower(name) for name in names})
