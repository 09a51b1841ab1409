"""One control period of n robots: motions plan it, filters change it, arms carry it out."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.filters.half_spaces import VelocityConstraints
from kinfeas.control.response import BaseResponse
from kinfeas.control.sequence import MotionSequence
from kinfeas.control.subgoal_motions import MotionStep
from kinfeas.core.checks import check_array
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.response import ResponseModel
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, integrate, relative
from kinfeas.kinematics.drive import base_twist
from kinfeas.kinematics.ik import IkSolution, IkSolver
from kinfeas.kinematics.solids import in_base
from kinfeas.robots.robot import exceeds_joint_velocity

RECONFIGURATION_SECONDS = 0.15
"""An arm further from its command than this time at full joint velocity is reconfiguring, rather
than lagging."""


@dataclass(frozen=True, kw_only=True)
class KinematicInputs:
    """Beginning and end of a control period of bases and arms."""

    base_pose: Array  # world pose of the base at the beginning, shape (n, 7)
    joints: Array  # where IK begins, shape (n, j), radians or metres: the last command
    # world pose of the EE at the end, or by the lead of a lagging arm later, shape (n, 7)
    desired: Array
    solids: Solids | None = None  # world solids at the end, n rows, which the arms avoid
    posture_guide: Array | None = None  # arm joints that IK prefers, shape (n, j); NaN for none
    motion: Array | None = None  # motions of bases that respond late, (n, 9); see `response`

    def of(self, rows: Rows) -> "KinematicInputs":
        """Return the inputs of some rows."""
        return KinematicInputs(
            base_pose=self.base_pose[rows],
            joints=self.joints[rows],
            desired=self.desired[rows],
            solids=None if self.solids is None else self.solids.of(rows),
            posture_guide=None if self.posture_guide is None else self.posture_guide[rows],
            motion=None if self.motion is None else self.motion[rows],
        )


@dataclass(frozen=True)
class Move:
    """Commands of bases and arms for one control period."""

    base_twist: Array  # world twists, shape (n, 6), m/s and rad/s
    arm: IkSolution  # IK solutions
    command: Array  # base commands from which they are computed, shape (n, a)
    base_pose: Array  # world poses of the bases at the end of the period, shape (n, 7)


@dataclass(frozen=True, kw_only=True)
class Period(KinematicInputs):
    """A control period that a loop is about to carry out."""

    command: Array  # base commands in [-1, 1], shape (n, 3) or (n, 2)
    step: MotionStep  # step of the motions
    time_scale: Array  # fraction of the planned motion that it carries out, shape (n,)
    motions: MotionSequence  # motions of the EEs, which do not change while filters read them
    paused: NDArray[np.bool_] | None = None  # rows whose arms reconfigure, (n,), or None
    velocity_constraints: VelocityConstraints | None = None  # of a preceding obstacle filter
    move: Move | None = None  # commands of bases and arms, where a filter has computed them

    @property
    def motion_seconds(self) -> Array:
        """Motion time of the step, seconds, shape (n,)."""
        seconds = self.step.seconds
        return seconds if self.paused is None else np.where(self.paused, 0.0, seconds)

    def changed(self, **fields: object) -> "Period":
        """Return the period with changed fields, faster than `dataclasses.replace`."""
        period = object.__new__(Period)
        vars(period).update(vars(self), **fields)
        return period

    def commanded(self, command: Array) -> "Period":
        """Return the period with other base commands, which are zero in paused rows."""
        if self.paused is not None:
            command = np.where(self.paused[:, np.newaxis], 0.0, command)
        return self if command is self.command else self.changed(command=command)

    def slowed(self, time_scale: Array) -> "Period":
        """Return the period with only fractions, shape (n,), of the planned motion.

        Raises:
            KinfeasError: If they have another shape or are not in [0, 1].
        """
        check_time_scale(time_scale, self.time_scale.shape, "the argument of period.slowed")
        step = self.motions.step(time_scale)
        desired = self.motions.arm_target(step, self.paused)
        return self.changed(step=step, desired=desired, time_scale=time_scale, move=None)


def check_time_scale(time_scale: Array, shape: tuple[int, ...], name: str) -> None:
    """Raise KinfeasError unless a value is an array of `shape` with fractions in [0, 1]."""
    check_array(time_scale, shape, name)
    if not ((time_scale >= 0.0) & (time_scale <= 1.0)).all():
        raise KinfeasError(f"{name} must be in [0, 1]")


class CommandFilter(Protocol):
    """Changes base commands before they are sent; entry points `kinfeas.filters`.

    A filter is built from keyword parameters. If its constructor names `solver`, `backend`, `dt`
    (seconds), `execution`, `response`, `stream` (None without moving targets) or `executor` (or
    None), `assemble` passes these. A filter with a state has `reset(rows, n)`, as a `Policy` does.
    One that needs time or memory for each robot has `max_batch`, the largest number in a process.
    """

    def __call__(self, period: Period) -> Period:
        """Return the changed period."""


class KinematicStep:
    """Effect of base commands in a control period of `dt` seconds: base twists, and arms by IK.

    `max_joint_step` is the longest displacement of each arm joint, shape (j,), radians or metres.
    """

    def __init__(self, solver: IkSolver, dt: float, response: ResponseModel) -> None:
        self.solver, self.dt, self._response = solver, dt, BaseResponse(response)
        self.max_joint_step: Array = solver.robot.max_joint_velocity * dt

    def __call__(
        self, command: Array, inputs: KinematicInputs, *, allow_reconfiguration: bool = True
    ) -> Move:
        """Return the commands of bases and arms for base commands, shape (n, 3) or (n, 2).

        With `allow_reconfiguration` IK also tries solutions out of reach in this period.
        """
        twist = base_twist(self.solver.robot.base, inputs.base_pose, command, self.dt)
        if inputs.motion is None:
            reached = integrate(inputs.base_pose, twist, self.dt)
        else:
            reached = self._response.reached(inputs.base_pose, inputs.motion, twist, self.dt)
        solids = inputs.solids
        arm = self.solver.solve(
            relative(inputs.desired, reached),
            inputs.joints,
            self.max_joint_step,
            allow_reconfiguration=allow_reconfiguration,
            solids=None if solids is None else in_base(solids, reached),
            posture_guide=inputs.posture_guide,
        )
        return Move(twist, arm, command, reached)


class Arm:
    """Arms that follow their bases.

    `joint_command` are the last commanded joints, shape (n, j), radians or metres; `waited` are the
    control periods for which each arm has been reconfiguring, shape (n,).
    """

    def __init__(
        self, solver: IkSolver, dt: float, response: ResponseModel, settle_timeout: float
    ) -> None:
        """Command arms in periods of `dt` seconds; pauses last `settle_timeout` seconds at most."""
        self._step, self._robot = KinematicStep(solver, dt, response), solver.robot
        self._settle_timeout = round(settle_timeout / dt)
        self.joint_command: Array = np.empty((0, len(solver.robot.arm)))
        self.waited: NDArray[np.intp] = np.empty(0, dtype=np.intp)

    def start(self, joint_positions: Array, rows: Rows | None) -> None:
        """Begin new episodes with measured arms, shape (n, j), in some rows, or in all of n."""
        if rows is None:
            self.joint_command = joint_positions.copy()
            self.waited = np.zeros(len(joint_positions), dtype=np.intp)
        else:
            self.joint_command = with_rows(self.joint_command, rows, joint_positions[rows])
            self.waited[rows] = 0

    def __call__(self, period: Period) -> Move:
        """Return the commands of bases and arms that reach the desired poses."""
        move = period.move
        if move is None or not (
            move.command is period.command or np.array_equal(move.command, period.command)
        ):
            move = self._step(period.command, period)
        self.joint_command = move.arm.joint_positions
        return move

    def pauses(self, joint_positions: Array) -> NDArray[np.bool_] | None:
        """Return which rows pause in this period, shape (n,), since their arms reconfigure.

        None if none does. Policies are trained with arms at their commands. During a
        reconfiguration they would read a large tracking error and drive the base after the EE.
        """
        if not self._settle_timeout:
            return None
        reconfigures = exceeds_joint_velocity(
            self._robot, joint_positions, self.joint_command, RECONFIGURATION_SECONDS
        )
        self.waited = np.where(reconfigures, self.waited + 1, 0)
        paused = reconfigures & (self.waited <= self._settle_timeout)
        return paused if paused.any() else None
