"""The monitor of a deployment: it checks what is measured."""

import math

import numpy as np

from kinfeas.core import spatial
from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.checks import check_state
from kinfeas.core.errors import Fault
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.sim2real.deploy.config import Guards
from kinfeas.sim2real.link.rate import Clock


class StateMonitor:
    """Checks one measurement after the other, and the clocks they are dated by.

    Attributes:
        state: Last measurement, also one that exceeds a limit; NaN if it is invalid.
    """

    def __init__(self, backend: Backend, robot: Robot, guards: Guards, clock: Clock) -> None:
        self._backend, self._source = backend, f"backend {type(backend).__name__}"
        self._robot, self._guards, self._clock = robot, guards, clock
        self._needs_age = backend.real_time is not None
        self._start: Array | None = None
        self._last, self._age = RobotState(np.empty((1, 7)), np.empty((1, 0))), 0.0
        nothing = np.full((1, 7), np.nan), np.full((1, len(robot.arm)), np.nan)
        self.state = self._invalid = RobotState(*nothing)
        self._times = (math.nan, math.nan)

    def begin(self, state: RobotState) -> None:
        """Take a measurement as the start of a run; raise Fault if it exceeds a limit."""
        self._start = None
        self._times = self._clock.monotonic(), self._clock.wall()
        self.check(state)
        self._start = state.base_pose[0].copy()

    def check(self, state: RobotState, dt: float = 0.0) -> None:
        """Raise Fault if a measurement, or the time since the last one, exceeds a limit.

        In worlds without a clock, `dt` seconds have passed since then.
        """
        self.state = self._invalid
        check_state(state, 1, len(self._robot.arm), self._source)
        self.state = state
        elapsed = self._check_clocks()
        if state.age is not None:
            self._check_age(state.age)
        elif self._needs_age:
            raise Fault(f"{self._source}: a real robot must return the age of its state")
        age = 0.0 if state.age is None else float(state.age[0])
        between = max(elapsed, dt) + max(0.0, self._age - age)  # s between the two measurements
        self._check_pose(state.base_pose[0], between)
        self._check_joints(state.joint_positions[0], between)
        base, joints = state.base_pose.copy(), state.joint_positions.copy()
        self._last, self._age = RobotState(base, joints), age

    def _check_clocks(self) -> float:
        before, self._times = self._times, (self._clock.monotonic(), self._clock.wall())
        elapsed = self._times[0] - before[0]
        check_limit("the control period took {} s", elapsed, self._guards.max_period)
        skew = abs(self._times[1] - before[1] - elapsed)
        check_limit("the system's clock was set by {} s", skew, self._guards.max_clock_skew)
        return elapsed

    def _check_age(self, age: Array) -> None:
        sentence = "the newest measurement is {} s old"
        check_age(sentence, age[0], self._guards.max_age, self._backend)
        check_limit("a measurement is {} s in the future", -age[0], self._guards.max_clock_skew)

    def _check_pose(self, pose: Array, elapsed: float) -> None:
        guards, base = self._guards, self._robot.base
        x, y, _, *quaternion = pose.tolist()
        tilt = 2.0 * math.hypot(*quaternion[:2])
        check_limit("the base leans by {} rad", tilt, guards.max_tilt)
        if self._start is None:
            return
        away = math.dist((x, y), self._start[:2].tolist())
        check_limit("the base is {} m from its start", away, guards.max_distance)
        metres, radians = map(float, spatial.distance(self._last.base_pose[0], pose))
        jump = "the measured base pose jumped by {} "
        check_limit(f"{jump}m", metres, guards.pose_jump + base.max_velocity * elapsed)
        check_limit(f"{jump}rad", radians, guards.heading_jump + base.max_rotation * elapsed)

    def _check_joints(self, joints: Array, elapsed: float) -> None:
        lower, upper = self._robot.joint_limits
        outside = np.maximum(lower - joints, joints - upper)
        worst = int(outside.argmax())
        sentence = f"joint {self._robot.arm[worst].name} is measured {{}} beyond its limits"
        check_limit(sentence, outside[worst], self._guards.joint_tolerance)
        if self._start is None:
            return
        robot, last = self._robot, self._last.joint_positions[0]
        moved = np.abs(joint_displacement(robot, last, joints))
        most = self._guards.measured_joint_jump + 2.0 * robot.max_joint_velocity * elapsed
        worst = int((moved - most).argmax())
        sentence = f"the measured joint {robot.arm[worst].name} jumped by {{}}"
        check_limit(sentence, moved[worst], most[worst])


def check_age(sentence: str, age: float, most: float, backend: Backend) -> None:
    """Raise Fault if a measurement is too old; it names the source that fell silent."""
    robot = backend.real_time
    source = robot.silent_source(most) if robot is not None and not age <= most else ""
    check_limit(f"{source}: {sentence}" if source else sentence, age, most)


def check_limit(sentence: str, value: float, most: float) -> None:
    """Raise Fault if a value is above a limit, or not a number."""
    if not value <= most:
        raise Fault(f"{sentence.format(f'{value:.4g}')}, at most {most:.3g} is allowed")
