"""Guards between a deployed policy and its robot.

`StateMonitor` checks measurements, `SafetyFilter` limits and checks commands, and `Guarded` stops
the robot if either raises. The adapters of a rehearsal lie between the filter and the monitor:

    loop -> Guarded (StateMonitor) -> adapters -> SafetyFilter -> backend of the robot
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinfeas.config import PluginSpec
from kinfeas.control.assemble import with_adapters
from kinfeas.core.backend import SCAN_BEAMS, Backend, BackendWrapper, Grip, RobotState, Scan
from kinfeas.core.checks import check_array, check_state
from kinfeas.core.errors import PLUGIN_ERRORS, Fault, plugin_note
from kinfeas.core.kernels import compiled
from kinfeas.core.pose_kernels import wrapped
from kinfeas.core.spatial import Array
from kinfeas.kinematics.drive import base_velocity, within_speed, world_twist
from kinfeas.robots.robot import Base, Robot
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.deploy.monitor import StateMonitor, check_age, check_limit
from kinfeas.sim2real.link.rate import Clock, Rate
from kinfeas.sim2real.link.scans import beam

_CREEP = 0.02  # m/s up to which the base may drive into a blind direction
_ROUNDING = 1e-12  # m, rad and their rates up to which the limits change a command by rounding only


class SafetyFilter(BackendWrapper):
    """Limits and checks each command before the backend of one robot gets it.

    A command must be finite and computed from a recent measurement. After `stop` nothing is sent
    until the next reset.

    Attributes:
        base_twist: Last world twist that was sent, shape (1, 6).
        joint_targets: Last joint targets that were sent, shape (1, j).
        hold: Reason why the arm held its position in the last step; empty otherwise.
        brake: Whether the base stops at once, past the limits of acceleration.
        stopped: Whether commands raise Fault: before the first reset, and after `stop`.
        steps: Number of commands sent.
    """

    def __init__(
        self, backend: Backend, robot: Robot, guards: Guards, clock: Clock, rate: Rate | None
    ) -> None:
        super().__init__(backend)
        self._robot, self._guards, self._clock, self._rate = robot, guards, clock, rate
        self._joint_speed = guards.joint_speed * robot.max_joint_velocity
        self._base_limits = _base_limits(robot.base, guards)
        self.base_twist, self.joint_targets = np.zeros((1, 6)), np.empty((1, 0))
        self.hold, self.brake, self.stopped, self.steps = "", False, True, 0
        self._dt = 0.0
        self.scanner, self.gripper = backend.scanner and self, backend.gripper and self

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Start a run; shapes as in `Backend`. Raises KinfeasError if there is no valid state."""
        if self.real_time is not None:
            self.real_time.limit_arm(self._joint_speed)
        state = self.backend.reset(base_pose, joint_positions, env_ids)
        check_state(state, 1, len(self._robot.arm), f"backend {type(self.backend).__name__}: reset")
        self._state, self._measured = state, self._clock.monotonic()
        self.base_twist, self.joint_targets = np.zeros((1, 6)), state.joint_positions.copy()
        self._velocity, self._blind = np.zeros(3), np.zeros(SCAN_BEAMS, dtype=np.bool_)
        self.hold, self.brake, self.stopped = "", False, False
        return state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Send a command within the limits; shapes as in `Backend`.

        Invalid or old commands, and any after a stop, raise Fault.
        """
        self._check_running()
        arm = (1, len(self._robot.arm))
        check_array(base_twist, (1, 6), "the base command", error=Fault)
        check_array(joint_targets, arm, "the arm command", error=Fault)
        base, pose = self._robot.base, self._state.base_pose
        velocity = base_velocity(base, pose, base_twist, dt)[0]
        # It depends on the measured heading, which an adapter may hide from the monitor.
        check_array(velocity, (3,), "the base command", error=Fault)
        if base.drive == "differential":
            velocity[1] = 0.0
        speed, rotation, *accelerations = self._base_limits
        change = _within(velocity, speed, rotation) - self._velocity
        velocity = self._velocity + _within(change, *(dt * limit for limit in accelerations))
        if self.brake:
            velocity = np.zeros(3)
        twist = _unrounded(world_twist(base, pose, velocity[np.newaxis], dt), base_twist)
        targets = self._arm_targets(joint_targets[0], dt)[np.newaxis]
        check_array(targets, arm, "the arm command", error=Fault)
        self._check_age()
        forward, left, _ = velocity.tolist()
        if math.hypot(forward, left) > _CREEP and self._blind[beam(np.arctan2(left, forward))]:
            raise Fault("the scan is blind in the direction of the base command")
        self._velocity, self._dt = velocity, dt
        self.base_twist, self.joint_targets = twist, targets
        if self._rate is not None:
            self._rate.worked()
        # A backend may write into its copies.
        self._state = self.backend.step(twist.copy(), targets.copy(), dt)
        self._measured = self._clock.monotonic()
        self.steps += 1
        return self._state

    def refresh(self, state: RobotState | None) -> None:
        """Take a measurement as the newest; None renews the last one of a world that is at rest."""
        if state is not None:
            self._state = state
        self._measured = self._clock.monotonic()

    def scan(self) -> Scan:
        """Return the newest ranges; raise Fault if they are old, not finite, or all blind."""
        assert self.backend.scanner is not None
        scan = self.backend.scanner.scan()
        check_limit("the newest scan is {} s old", scan.age, self._guards.max_scan_age)
        self._blind = np.zeros(SCAN_BEAMS, np.bool_) if scan.blind is None else scan.blind
        if self._blind.all():
            raise Fault("the scan is blind in all directions")
        check_array(scan.ranges, (1, 2, SCAN_BEAMS), "the scan", error=Fault)
        return scan

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Close or open the gripper; raise Fault after a stop."""
        self._check_running()
        assert self.backend.gripper is not None
        self.backend.gripper.grip(grip, env_ids)

    def stop(self) -> None:
        """Command the base to zero and the arm to hold; it may be called at any time."""
        running, self.stopped = not self.stopped, True
        self.base_twist, self._velocity = np.zeros((1, 6)), np.zeros(3)
        if self.real_time is not None:
            self.real_time.stop()
        elif running and self._dt > 0.0:  # nothing moves before the first step
            self.backend.step(self.base_twist, self.joint_targets, self._dt)

    def close(self) -> None:
        """Close the backend."""
        with plugin_note(f"backend {type(self.backend).__name__}"):
            self.backend.close()

    def _check_running(self) -> None:
        if self.stopped:
            raise Fault("the robot was stopped")

    def _check_age(self) -> None:
        """Check the age of the measurement from which the command was computed."""
        elapsed = self._clock.monotonic() - self._measured
        age = elapsed + (0.0 if self._state.age is None else float(self._state.age[0]))
        sentence = "the command is made of a measurement {} s old"
        check_age(sentence, age, self._guards.max_age, self.backend)

    def _arm_targets(self, targets: Array, dt: float) -> Array:
        """Return targets that the arm reaches within `dt`, (j,); if it must hold, the last ones."""
        robot, guards, before = self._robot, self._guards, self.joint_targets[0]
        limits = self._joint_speed, robot.continuous, *robot.joint_limits
        measured = self._state.joint_positions[0]
        after, farthest, lag = _limited_targets(targets, before, measured, *limits, dt)
        self.hold = ""
        if farthest > guards.joint_jump:
            self.hold = "the arm's target is too far away"
        elif not lag.max() <= guards.max_tracking_delay:  # also if the measurement is not a number
            self.hold = f"joint {robot.arm[int(lag.argmax())].name} does not follow"
        return before if self.hold else _unrounded(after, targets)


@compiled(
    ["void(f8[:], f8[:], f8[:], f8[:], b1[:], f8[:], f8[:], f8, f8[:], f8[:], f8[:])"],
    "(j),(j),(j),(j),(j),(j),(j),()->(j),(),(j)",
)
def _limited_targets(  # noqa: PLR0913, PLR0917 - a kernel of flat arrays
    targets: Array, before: Array, measured: Array, speed: Array, continuous: NDArray[np.bool_],
    lower: Array, upper: Array, dt: float, out: Array, farthest: Array, lag: Array,
) -> None:  # fmt: skip
    """Write to `out` how far the joints get from `before` towards `targets` in `dt` seconds.

    Joints are in radians or metres, and slow down alike. `farthest` is the largest displacement of
    a joint to its next target, `lag` the seconds that each needs to its last one, `before`.
    """
    farthest[0], periods = 0.0, 1.0
    for j in range(len(out)):
        change, behind = targets[j] - before[j], before[j] - measured[j]
        if continuous[j]:
            change, behind = wrapped(change), wrapped(behind)
        out[j], lag[j] = change, abs(behind) / speed[j]
        farthest[0] = max(farthest[0], abs(change))
        periods = max(periods, abs(change) / (speed[j] * dt))
    for j in range(len(out)):
        target = before[j] + out[j] / periods
        target = wrapped(target) if continuous[j] else target
        # A joint that starts beyond a limit must not jump to it.
        out[j] = min(max(target, min(lower[j], before[j])), max(upper[j], before[j]))


class Guarded(BackendWrapper):
    """The backend that a deployed loop sees: it stops the robot if anything raises.

    Attributes:
        guards: Limits.
        commands: Filter of the commands.
        command: Last world twist, shape (1, 6), and joint targets, (1, j), except those of `stop`:
            as sent or, if there are adapters, as passed to `step`.
        unstopped: Why the base could not be commanded to zero; empty if it could.
        unclosed: Why the backend could not be closed; empty if it could.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        guards: Guards | None = None,
        *,
        adapters: Sequence[PluginSpec] = (),
        rate: Rate | None = None,
        clock: Clock | None = None,
    ) -> None:
        """Put guards around the backend of one robot.

        Adapters of a rehearsal come between, the first one next to the backend. `rate` measures the
        control periods.
        """
        self.guards, clock = guards or Guards(), clock or Clock()
        self.commands = SafetyFilter(backend, robot, self.guards, clock, rate)
        super().__init__(with_adapters(self.commands, adapters, robot))
        self.scanner = self.backend.scanner and self
        self._rate = rate
        self._name = f"backend {type(backend).__name__}"
        self._monitor = StateMonitor(backend, robot, self.guards, clock)
        self._failures = 0
        self.command = self.commands.base_twist, self.commands.joint_targets
        self.unstopped = self.unclosed = ""

    @property
    def state(self) -> RobotState:
        """Newest state, even if the monitor stopped the robot because of it; NaN if invalid."""
        return self._monitor.state

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Start a run; shapes as in `Backend`. Raises KinfeasError if a limit is exceeded."""
        with plugin_note(self._name):
            state = self.backend.reset(base_pose, joint_positions, env_ids)
        self._monitor.begin(state)
        self.command = self.commands.base_twist, self.commands.joint_targets
        self._failures, self.unstopped = 0, ""
        return state

    def read(self) -> RobotState | None:
        """Return the state of a robot that moves in real time; None for a simulated world."""
        if self.real_time is None:
            return None
        with plugin_note(self._name):
            state = self.real_time.read()
        self._monitor.begin(state)
        return state

    def refresh(self) -> RobotState:
        """Return the newest measurement after a long start at rest; begin the first period."""
        state = self.read()
        self.commands.refresh(state)
        if state is None:
            self._monitor.begin(self.state)
        if self._rate is not None and self._rate.waits:
            self._rate.restart()
        return self.state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Execute a command; shapes as in `Backend`. If anything raises, the robot is stopped."""
        steps, passed = self.commands.steps, False
        command = base_twist.copy(), joint_targets.copy()
        try:
            state = self.backend.step(base_twist, joint_targets, dt)
            if self.commands.steps == steps:
                raise Fault("an adapter has not passed the command on")
            if self.backend is self.commands:
                command = self.commands.base_twist, self.commands.joint_targets
            self.command = command
            if self._rate is not None:
                self._rate.wait()
            self._monitor.check(state, dt)
            passed = True
        finally:
            if not passed:
                self.stop()
        return state

    def scan(self) -> Scan:
        """Return the newest ranges; if anything raises, the robot is stopped."""
        assert self.backend.scanner is not None
        try:
            return self.backend.scanner.scan()
        except PLUGIN_ERRORS:
            self.stop()
            raise

    def count(self, *, feasible: bool) -> None:
        """Stop and raise Fault after too many periods in a row on hold or without IK solution."""
        hold, most = self.commands.hold, self.guards.max_consecutive_ik_failures
        self._failures = 0 if feasible and not hold else self._failures + 1
        if self._failures > most:
            self.stop()
            why = hold or "IK finds no solution"
            raise Fault(f"{why}, for more than {most} steps in a row")

    def stop(self) -> None:
        """Command the base to zero and the arm to hold, bypassing adapters; raise nothing."""
        try:
            self.commands.stop()
        except PLUGIN_ERRORS as error:
            self.unstopped = str(error) or repr(error)  # the watchdog will try again

    def close(self) -> None:
        """Stop the robot and close the backend; raise nothing."""
        self.stop()
        try:
            self.backend.close()
        except PLUGIN_ERRORS as error:
            if not self.unstopped:  # else the connection is already reported as lost
                self.unclosed = str(error) or repr(error)


def _within(velocity: Array, speed: float, rotation: float) -> Array:
    """Return a velocity of the base, shape (3,), scaled and clipped to limits."""
    forward, left, turn = velocity.tolist()
    planar = within_speed(forward, left, speed)
    return np.array([*planar, min(max(turn, -rotation), rotation)])


def _unrounded(limited: Array, command: Array) -> Array:
    """Return limited commands; where these differ by rounding only, the original ones."""
    return np.where(np.abs(limited - command) <= _ROUNDING, command, limited)


def _base_limits(base: Base, guards: Guards) -> list[float]:
    """Return the limits of speed, rotation and their accelerations, never above the robot's own."""
    limits = (
        (base.max_velocity, guards.max_linear_velocity),
        (base.max_rotation, guards.max_angular_velocity),
        (base.max_acceleration, guards.acceleration),
        (base.max_rotation_acceleration, guards.rotation_acceleration),
    )
    return [min(own, own if guard is None else guard) for own, guard in limits]
