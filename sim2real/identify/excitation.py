"""A minute of commands that show how a robot responds: steps and chirps of base and arm."""

import math
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.period import Move, Period
from kinfeas.control.targets import StreamProgress
from kinfeas.core import spatial
from kinfeas.core.motion import Rows
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.drive import base_twist, command_size
from kinfeas.kinematics.ik import IkSolution, IkSolver
from kinfeas.kinematics.self_collision import self_collides
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import MotionSpec, Subgoal, start_at_home

SECONDS = 60.0
"""Duration of the pattern."""

_VELOCITY, _ROTATION = 0.3, 0.6  # m/s and rad/s that the base does not exceed
_ARM_STEP, _ARM_FRACTION = 0.4, 0.4  # rad or m of each joint, and fraction of the room to its limit
_ARM_SPEED = 0.3  # fraction of the velocity limit of a joint, so that no clamp is met
_ARM_BEGIN, _ARM_CYCLE, _ARM_CYCLES = 4.0, 12.0, 4  # s of rest, of a cycle, and their number
_ARM_CHIRP, _ARM_SWEEP, _ARM_SWINGS = 0.3, 0.08, 3  # Hz at first, Hz/s, and number of swings
_CHECKED = 5  # periods between configurations that are checked for self-collision

# Seconds of each reversal, forth and back, by axis: 0 forward, 1 left, 2 rotation. They are long
# enough for slow bases to reach their velocity: else a late command changes all that follows.
_BLOCKS: tuple[tuple[int, tuple[float, ...]], ...] = (
    (2, (2.2, 1.7, 2.4)),
    (0, (1.7, 1.5, 1.9)),
    (1, (1.6, 1.8)),
    (2, (2.0, 2.3)),
    (0, (1.8,)),
    (1, (1.7,)),
)
_REST, _PAUSE = 4.0, 0.9  # s at the beginning, and after each block


def base_pattern(robot: Robot, dt: float) -> Array:
    """Return base commands in [-1, 1] by control period, shape (k, a).

    The base drives forth and back. Since a slow base drives farther forth than back, the blocks of
    an axis begin in alternating directions, so that the base ends near its start.
    """
    size = command_size(robot.base)
    speed = min(1.0, _VELOCITY / robot.base.max_velocity)
    scale = np.array([speed, speed, min(1.0, _ROTATION / robot.base.max_rotation)])
    pieces = [np.zeros((round(_REST / dt), 3))]
    first = np.ones(3)
    for named, seconds in _BLOCKS:
        axis = 0 if size == 2 and named == 1 else named
        for duration in seconds:
            for sign in (first[axis], -first[axis]):
                piece = np.zeros((round(duration / dt), 3))
                piece[:, axis] = sign
                pieces.append(piece)
        first[axis] *= -1.0
        pieces.append(np.zeros((round(_PAUSE / dt), 3)))
    steps = round(SECONDS / dt)
    pattern = np.concatenate([*pieces, np.zeros((steps, 3))])[:steps] * scale
    return pattern if size == 3 else pattern[:, [0, 2]]


def arm_pattern(dt: float) -> Array:
    """Return the displacement of the arm as a fraction in [0, 1] by control period, shape (k,).

    Each cycle is a chirp up to 0.75 Hz and a staircase of fast steps.
    """
    time = np.arange(round(SECONDS / dt)) * dt - _ARM_BEGIN
    phase = np.mod(time, _ARM_CYCLE)
    swings = _ARM_CHIRP * phase + 0.5 * _ARM_SWEEP * phase**2
    stairs = np.interp(
        phase, [6.5, 7.0, 7.4, 7.9, 8.3, 8.8, 9.3, 9.8, 10.4, 10.9],
        [0.0, 0.5, 0.5, 1.0, 1.0, 0.5, 0.5, 1.0, 1.0, 0.0],
    )  # fmt: skip
    pattern = np.where(swings < _ARM_SWINGS, 0.5 - 0.5 * np.cos(2.0 * math.pi * swings), stairs)
    return np.where((time >= 0.0) & (time < _ARM_CYCLES * _ARM_CYCLE), pattern, 0.0)


def arm_amplitude(solver: IkSolver, joints: Array, dt: float) -> Array:
    """Return the signed motion of each joint from a configuration, both of shape (j,), rad or m.

    Joints move away from their nearer limit, all at once, within limits of speed and range; the
    displacements shrink, to zero at last, until the robot does not collide with itself.
    """
    robot, pattern = solver.robot, arm_pattern(dt)
    lower, upper = robot.joint_limits
    below, above = joints - lower, upper - joints
    room = np.minimum(_ARM_STEP, _ARM_FRACTION * np.maximum(below, above))
    fastest = float(np.abs(np.diff(pattern)).max()) / dt
    amplitude = np.minimum(room, _ARM_SPEED * robot.max_joint_velocity / fastest)
    amplitude = np.where(above >= below, amplitude, -amplitude)
    fractions = np.unique(pattern[::_CHECKED])[:, np.newaxis]
    for shrunk in (amplitude, amplitude / 2.0, amplitude / 4.0):
        if not self_collides(solver.collision, joints + fractions * shrunk).any():
            return shrunk
    return np.zeros(len(joints))


class Excitation:
    """The pattern for one robot: task, target stream and command filter of a run.

    It replaces the commands of base and arm, and a deployment limits, sends and records them.

    Attributes:
        live: False where the base stops at once in the next period, shape (1,).
    """

    name, seconds = "excitation", SECONDS

    def __init__(self, solver: IkSolver, dt: float) -> None:
        """Compute the commands of `dt` seconds each, and compile the check of self-collision."""
        self._solver, self._dt, self._period = solver, dt, 0
        self._base, self._arm = base_pattern(solver.robot, dt), arm_pattern(dt)
        changes = np.abs(np.diff(self._base, axis=0, append=0.0)).max(axis=1) > 0.0
        self._stops: NDArray[np.bool_] = changes & (np.abs(self._base).max(axis=1) > 0.0)
        self._start = solver.robot.home["home"]
        self._amplitude = arm_amplitude(solver, self._start, dt)
        self._desired = np.empty((1, 7))
        self.live = np.ones(1, dtype=np.bool_)

    @property
    def subgoals(self) -> tuple[Subgoal, ...]:
        """One sub-goal, at which the EE is not aimed."""
        return (Subgoal(MotionSpec("servo")),)

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return the start at the origin with the arm at home."""
        return start_at_home(solver.robot)

    def target_stream(self, solver: IkSolver) -> Self:
        """Return this object."""
        return self

    def start(self, desired: Array, rngs: Sequence[np.random.Generator], rows: Rows) -> None:
        """Begin the pattern; the EE has no other target than its pose, shape (1, 7)."""
        self._desired, self._period, self.live = desired, 0, np.ones(1, dtype=np.bool_)

    def targets(self, progress: StreamProgress) -> Array:
        """Return the pose of the start, shape (1, 7)."""
        return self._desired

    @property
    def speed(self) -> Array:
        """Return zero, shape (1,): no target moves."""
        return np.zeros(1)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the number of the period."""
        return {"period": np.array(self._period)}

    def restore(self, snapshot: dict[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        self._period = int(snapshot["period"])

    def __call__(self, period: Period) -> Period:
        """Return the period with the commands of the pattern for base and arm."""
        if self._period == 0:
            self._start = period.joints[0]
            self._amplitude = arm_amplitude(self._solver, self._start, self._dt)
        number = min(self._period, len(self._base) - 1)
        # At the end of each piece the base stops at once, past the guards' acceleration.
        self.live = np.array([not self._stops[number]])
        self._period += 1
        command = self._base[number : number + 1]
        joints = self._start + self._arm[number] * self._amplitude
        twist = base_twist(self._solver.robot.base, period.base_pose, command, self._dt)
        reached = spatial.integrate(period.base_pose, twist, self._dt)
        zero = np.zeros(1)
        arm = IkSolution(joints[np.newaxis], np.ones(1, dtype=np.bool_), zero, zero)
        return period.changed(command=command, move=Move(twist, arm, command, reached))
