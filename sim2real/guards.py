"""The guards of a deployed policy, as a wrapper around the backend of its robot.

Whatever policy, IK and backend give, what goes out obeys the limits or commands the base to zero.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinfeas.backend import Backend, Live, RobotState
from kinfeas.errors import KinfeasError
from kinfeas.foreign import USUAL
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.drive_limits import DriveLimits, arm_go, arm_move, from_drive, to_drive
from kinfeas.sim2real.fault import Fault
from kinfeas.sim2real.guard_config import Guards
from kinfeas.sim2real.measurement_guard import MeasurementGuard
from kinfeas.sim2real.passing import Passing
from kinfeas.spatial import Array


@dataclass(frozen=True)
class Clocks:
    """What tells the time, both in seconds; a test has its own.

    Attributes:
        steady: Never set, so that durations are measured by it.
        wall: The system's clock, which stamps are made with.
    """

    steady: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time


class Guarded(Passing):
    """A backend of one robot behind guards.

    Once it has raised, or was stopped, it commands nothing any more.

    Attributes:
        base_twist: World twist that was commanded last, shape (1, 6).
        joint_targets: Arm joints that were commanded last, shape (1, j).
        state: What was measured last and believed.
        stopped: Whether the base was commanded to zero for good.
        unstopped: Why that could not be sent, or nothing.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        guards: Guards | None = None,
        *,
        live: Live | None = None,
        clocks: Clocks | None = None,
    ) -> None:
        """Put guards around a backend.

        Args:
            backend: What moves the robot, with its adapters.
            robot: Who is moved.
            guards: What is allowed; the defaults by default.
            live: The robot itself within the adapters, if it moves by its own clock.
            clocks: What tells the time.
        """
        super().__init__(backend)
        self.robot, self.guards = robot, guards or Guards()
        self.live, self._clocks = live, clocks or Clocks()
        self._limits = _limits(robot, self.guards)
        self._joint_speed = self.guards.joint_speed * robot.max_joint_velocity
        self._measured = MeasurementGuard(robot, self.guards, needs_age=live is not None)
        self._velocity, self._dt = np.zeros(3), 0.0
        self._steady = self._wall = np.nan
        self._fails, self._held = 0, False
        self.unstopped = ""
        self.stopped, self.state = True, RobotState(np.empty((0, 7)), np.empty((0, 0)))
        self.base_twist, self.joint_targets = np.zeros((1, 6)), np.empty((1, 0))

    def reset(
        self, base_pose: Array, joint_positions: Array, rows: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Begin anew; shapes as in `Backend`.

        Raises:
            Fault: If what is measured cannot be believed.
        """
        state = self.backend.reset(base_pose, joint_positions, rows)
        self._measured.begin(state)
        self.base_twist, self.joint_targets = np.zeros((1, 6)), state.joint_positions.copy()
        self._velocity, self._fails = np.zeros(3), 0
        self._held, self.unstopped = False, ""
        self._steady, self._wall = self._clocks.steady(), self._clocks.wall()
        self.stopped, self.state = False, state
        return state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send what is allowed of a command and return what was measured; shapes as in `Backend`.

        Raises:
            Fault: If the run must not go on; the base is commanded to zero before.
        """
        if self.stopped:
            raise Fault("the base was stopped")
        passed, self._dt = False, dt
        try:
            self._check_delay()
            self.base_twist, self.joint_targets = self._allowed(base_twist, joint_targets, dt)
            state = self.backend.step(self.base_twist, self.joint_targets, dt)
            elapsed = self._check_period()
            self._measured.check(state, elapsed)
            self.state, passed = state, True
        finally:
            if not passed:
                self.stop()
        return state

    def judge(self, *, feasible: bool) -> None:
        """Count the control periods in a row in which the arm could not go where it should.

        Args:
            feasible: Whether IK found the desired pose in this one.

        Raises:
            Fault: If there were too many; the base is commanded to zero before.
        """
        self._fails = 0 if feasible and not self._held else self._fails + 1
        if self._fails > self.guards.infeasible_steps:
            self.stop()
            why = "the arm's target is too far away" if self._held else "IK finds no solution"
            raise Fault(f"{why}, for more than {self.guards.infeasible_steps} steps in a row")

    def stop(self) -> None:
        """Command the base to zero, and the arm to stay; it may be called at any time, and twice.

        A robot with a clock of its own is commanded past the adapters, which may delay or lose it.
        """
        drove, self.stopped = not self.stopped, True
        self.base_twist, self._velocity = np.zeros((1, 6)), np.zeros(3)
        try:
            if self.live is not None:
                self.live.stop()
            elif drove and self._dt > 0.0:  # before the first step nothing moves
                self.backend.step(self.base_twist, self.joint_targets, self._dt)
        except (KinfeasError, *USUAL) as error:
            # What has led here is what the user must hear of; the watchdog tries again.
            self.unstopped = str(error) or type(error).__name__

    def close(self) -> None:
        """Stop the base and close the backend; it may be called twice."""
        self.stop()
        try:
            self.backend.close()
        except KinfeasError:
            if not self.unstopped:  # or else it is known already that nothing can be sent
                raise

    def _allowed(self, base_twist: Array, joint_targets: Array, dt: float) -> tuple[Array, Array]:
        """Return what is sent of a command, of the same shapes."""
        wanted = (1, 6), (1, len(self.robot.arm))
        if (base_twist.shape, joint_targets.shape) != wanted:
            shapes = base_twist.shape, joint_targets.shape
            raise Fault(f"the command has the shapes {shapes}, robot {self.robot.name} {wanted}")
        if not np.isfinite(base_twist).all():
            raise Fault("the command for the base is not finite")
        if not np.isfinite(joint_targets).all():
            raise Fault("the command for the arm is not finite")
        base, pose = self.robot.base, self.state.base_pose[0]
        velocity = to_drive(base, pose, base_twist[0], dt)
        self._velocity = self._limits.clamp(velocity, self._velocity, dt)
        twist = from_drive(base, pose, self._velocity, dt)
        return twist[np.newaxis], self._arm(joint_targets[0], dt)[np.newaxis]

    def _arm(self, targets: Array, dt: float) -> Array:
        """Return how far toward targets, shape (j,), the arm can follow."""
        before = self.joint_targets[0]
        move = arm_move(self.robot, before, targets)
        self._held = bool(np.abs(move).max() > self.guards.joint_jump)
        if self._held:
            return before
        share = np.max(np.abs(move) / (self._joint_speed * dt), initial=1.0)
        return arm_go(self.robot, before, move / share)

    def _check_delay(self) -> None:
        """Raise if the measurement that a command is made of has become too old meanwhile."""
        age = 0.0 if self.state.age is None else float(np.max(self.state.age))
        old = self._elapsed() + age
        if old > self.guards.max_age:
            most = f"at most {self.guards.max_age:g} s is allowed"
            raise Fault(f"the command is made of a measurement {old:.2f} s old, {most}")

    def _check_period(self) -> float:
        """Return the seconds that the backend took; raise if they were too many."""
        elapsed = self._elapsed()
        if elapsed > self.guards.max_stall:
            most = f"at most {self.guards.max_stall:g} s is allowed"
            raise Fault(f"the control period took {elapsed:.2f} s, {most}")
        return elapsed

    def _elapsed(self) -> float:
        """Return the seconds since this was asked last; raise if a clock cannot be believed."""
        steady, wall = self._clocks.steady(), self._clocks.wall()
        elapsed, jump = steady - self._steady, (wall - self._wall) - (steady - self._steady)
        self._steady, self._wall = steady, wall
        if not elapsed >= 0.0:
            raise Fault(f"the clock went backwards by {-elapsed:.2f} s")
        if not abs(jump) <= self.guards.clock_jump:
            raise Fault(f"the system's clock was set by {jump:+.2f} s")
        return elapsed


def _limits(robot: Robot, guards: Guards) -> DriveLimits:
    """Return the limits of a robot's base, or those of the guards where they are lower."""
    own = DriveLimits.of(robot.base)

    def lower(name: str) -> float:
        most: float | None = getattr(guards, name)
        return getattr(own, name) if most is None else min(most, getattr(own, name))

    names = ("speed", "rotation", "acceleration", "rotation_acceleration")
    return replace(own, **{name: lower(name) for name in names})


def check_action(action: Array, size: int) -> Array:
    """Return the action of one robot, shape (1, size), if it is one.

    Raises:
        Fault: If it has another shape or is not finite.
    """
    if action.shape != (1, size):
        raise Fault(f"the policy's action has the shape {action.shape}, not {(1, size)}")
    if not np.isfinite(action).all():
        raise Fault("the policy's action is not finite")
    return action
