"""The guards of a deployed policy, as a wrapper around the backend of its robot.

Whatever policy, IK and backend give, what goes out obeys the limits or commands the base to zero.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinfeas.config import PluginSpec
from kinfeas.control.adapters import wrap
from kinfeas.core.backend import Backend, RealTimeBackend, RobotState
from kinfeas.core.errors import PLUGIN_ERRORS
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.deploy.command_guard import CommandGuard, check_age, check_command
from kinfeas.sim2real.deploy.guard_config import Guards
from kinfeas.sim2real.deploy.measurement_guard import MeasurementGuard
from kinfeas.sim2real.deploy.passing import Passing
from kinfeas.sim2real.deploy.rate import Rate
from kinfeas.sim2real.deploy.timed import Timed
from kinfeas.sim2real.link.fault import Fault, beyond, reason_of


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
    """A backend of one robot behind guards: between the loop and the adapters.

    Whatever policy, IK and adapters give, `CommandGuard` sends nothing beyond the limits. This
    looks at clocks and measurements. Once it has raised, or was stopped, nothing is commanded any
    more.

    Attributes:
        state: What was measured last and believed.
        unstopped: Why the base could not be commanded to zero, or nothing.
        unclosed: Why the backend could not be closed, or nothing.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        guards: Guards | None = None,
        *,
        adapters: Sequence[PluginSpec] = (),
        rate: Rate | None = None,
        clocks: Clocks | None = None,
    ) -> None:
        """Put guards around a backend.

        Args:
            backend: What moves the robot.
            robot: Who is moved.
            guards: What is allowed; the defaults by default.
            adapters: What stands between the two guards, the first one next to the backend.
            rate: What makes a simulated world keep to the clock on the wall.
            clocks: What tells the time.

        Raises:
            KinfeasError: If there is no such adapter, or it refuses its parameters.
        """
        self.guards, self._clocks = guards or Guards(), clocks or Clocks()
        self._commands = CommandGuard(backend, robot, self.guards, self._clocks.steady)
        wrapped = wrap(self._commands, adapters, robot)
        super().__init__(wrapped if rate is None else Timed(wrapped, rate))
        needs_age = isinstance(backend, RealTimeBackend)
        self._measured = MeasurementGuard(robot, self.guards, needs_age=needs_age)
        self._steady = self._wall = np.nan
        self._fails = 0
        self.unstopped = self.unclosed = ""
        self.state = RobotState(np.empty((0, 7)), np.empty((0, 0)))

    @property
    def base_twist(self) -> Array:
        """World twist that was sent last, shape (1, 6)."""
        return self._commands.base_twist

    @property
    def joint_targets(self) -> Array:
        """Arm joints that were sent last, shape (1, j)."""
        return self._commands.joint_targets

    @property
    def stopped(self) -> bool:
        """Whether the base was commanded to zero for good."""
        return self._commands.stopped

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Begin anew; shapes as in `Backend`.

        Raises:
            Fault: If what is measured cannot be believed.
        """
        state = self.backend.reset(base_pose, joint_positions, env_ids)
        self._measured.begin(state)
        self._fails, self.unstopped = 0, ""
        self._steady, self._wall = self._clocks.steady(), self._clocks.wall()
        self.state = state
        return state

    def look(self) -> RobotState | None:
        """Return where a robot stands that moves by its own clock; None of any other.

        Raises:
            KinfeasError: If a backend from outside fails, or returns no state.
            Fault: If what is measured cannot be believed.
        """
        state = self._commands.look()
        if state is not None:
            self._measured.begin(state)
        return state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send what is allowed of a command and return what was measured; shapes as in `Backend`.

        Raises:
            Fault: If the run must not go on; the base is commanded to zero before.
        """
        if self.stopped:
            raise Fault("the base was stopped")
        passed = False
        try:
            self._check_delay()
            check_command(self._commands.robot, base_twist, joint_targets)
            joint_command = self._commands.steps
            state = self.backend.step(base_twist, joint_targets, dt)
            if self._commands.steps == joint_command:
                raise Fault("an adapter has not passed the command on")
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
        held = self._commands.held
        self._fails = 0 if feasible and not held else self._fails + 1
        if self._fails > self.guards.max_consecutive_ik_failures:
            self.stop()
            why = held or "IK finds no solution"
            raise Fault(
                f"{why}, for more than {self.guards.max_consecutive_ik_failures} steps in a row"
            )

    def stop(self) -> None:
        """Command the base to zero, and the arm to stay; it may be called at any time, and twice.

        It goes past the adapters, which may delay or lose a command.
        """
        try:
            self._commands.stop()
        except PLUGIN_ERRORS as error:
            # What has led here is what the user must hear of; the watchdog tries again.
            self.unstopped = reason_of(error)

    def close(self) -> None:
        """Stop the base and close the backend; it may be called twice, and raises nothing."""
        self.stop()
        try:
            self.backend.close()
        except PLUGIN_ERRORS as error:
            if not self.unstopped:  # or else it is known already that nothing can be sent
                self.unclosed = reason_of(error)

    def _check_delay(self) -> None:
        """Raise if the measurement that a command is made of has become too old meanwhile."""
        check_age(self.state, self._elapsed(), self.guards.max_age)

    def _check_period(self) -> float:
        """Return the seconds that the backend took; raise if they were too many."""
        elapsed, most = self._elapsed(), self.guards.max_period
        if elapsed > most:
            took = f"the control period took {beyond(elapsed, most)} s"
            raise Fault(f"{took}, at most {most:g} s is allowed")
        return elapsed

    def _elapsed(self) -> float:
        """Return the seconds since this was asked last; raise if a clock cannot be believed."""
        steady, wall = self._clocks.steady(), self._clocks.wall()
        elapsed, jump = steady - self._steady, (wall - self._wall) - (steady - self._steady)
        self._steady, self._wall = steady, wall
        if not elapsed >= 0.0:
            raise Fault(f"the clock went backwards by {beyond(-elapsed, 0.0)} s")
        if not abs(jump) <= self.guards.max_clock_skew:
            sign = "-" if jump < 0.0 else "+"
            raise Fault(
                f"the system's clock was set by {sign}"
                f"{beyond(abs(jump), self.guards.max_clock_skew)} s"
            )
        return elapsed


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
