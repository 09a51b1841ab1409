"""One control period of n robots: a value from the motions, through the filters, to the arms."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.filters.half_spaces import VelocityConstraints
from kinfeas.control.sequence import MotionSequence, MotionStep
from kinfeas.core.motion import Rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, integrate, relative
from kinfeas.kinematics.drive import base_twist
from kinfeas.kinematics.ik import IkSolution, IkSolver
from kinfeas.kinematics.solids import in_base


@dataclass(frozen=True, kw_only=True)
class KinematicInputs:
    """Beginning and end of a control period of bases and arms.

    Attributes:
        base_pose: World pose of the base at the beginning, shape (n, 7).
        joints: Arm joints at which IK begins, shape (n, j), radians or metres: the last command.
        desired: World pose of the EE at the end, shape (n, 7).
        solids: World solids at the end, n rows, which the arms avoid.
        posture_guide: Arm joints that IK prefers, shape (n, j); NaN for none.
    """

    base_pose: Array
    joints: Array
    desired: Array
    solids: Solids | None = None
    posture_guide: Array | None = None

    def of(self, rows: Rows) -> "KinematicInputs":
        """Return the inputs of some rows."""
        return KinematicInputs(
            base_pose=self.base_pose[rows],
            joints=self.joints[rows],
            desired=self.desired[rows],
            solids=None if self.solids is None else self.solids.of(rows),
            posture_guide=None if self.posture_guide is None else self.posture_guide[rows],
        )


@dataclass(frozen=True)
class Move:
    """Commands of bases and arms for one control period.

    Attributes:
        base_twist: World twists, shape (n, 6), m/s and rad/s.
        arm: IK solutions.
        command: Base commands of which they come, shape (n, a).
    """

    base_twist: Array
    arm: IkSolution
    command: Array


@dataclass(frozen=True, kw_only=True)
class Period(KinematicInputs):
    """A control period that a loop is about to carry out.

    Attributes:
        command: Base commands in [-1, 1], shape (n, 3) or (n, 2).
        step: Step of the motions.
        time_scale: Fraction of the planned motion that it carries out, shape (n,).
        motions: Motions of the EEs, which do not change while filters read them.
        paused: Whether base and motion pause while the arm reconfigures, shape (n,); None if none
            does.
        velocity_constraints: Constraints of an obstacle filter, for the filters after it.
        move: Commands of bases and arms, where a filter has computed them.
    """

    command: Array
    step: MotionStep
    time_scale: Array
    motions: MotionSequence
    paused: NDArray[np.bool_] | None = None
    velocity_constraints: VelocityConstraints | None = None
    move: Move | None = None

    @property
    def motion_seconds(self) -> Array:
        """Motion time of the step, seconds, shape (n,)."""
        seconds = self.step.seconds
        return seconds if self.paused is None else np.where(self.paused, 0.0, seconds)

    def commanded(self, command: Array) -> "Period":
        """Return the period with other base commands, which are zero in paused rows."""
        if self.paused is not None:
            command = np.where(self.paused[:, np.newaxis], 0.0, command)
        return self if command is self.command else replace(self, command=command)

    def slowed(self, time_scale: Array) -> "Period":
        """Return the period with fractions, shape (n,), of the planned motion."""
        step = self.motions.step(time_scale)
        desired = self.motions.after(step, self.paused)
        return replace(self, step=step, desired=desired, time_scale=time_scale, move=None)


class CommandFilter(Protocol):
    """Changes base commands before they are sent; entry points `kinfeas.filters`.

    A filter is built from keyword parameters, and from those of `assemble.OFFERED` that it names.
    One with a state has `reset(rows, n)`, as a `Policy`; `max_batch` limits the robots of a process
    if it needs time or memory for each.
    """

    def __call__(self, period: Period) -> Period:
        """Return the changed period."""
        ...


class KinematicStep:
    """Effect of base commands in one control period: base twists, and arms by IK.

    Attributes:
        solver: IK of the robot.
        dt: Control period in seconds.
        max_joint_step: Longest displacement of each arm joint in a period, shape (j,), radians or
            metres.
    """

    def __init__(self, solver: IkSolver, dt: float) -> None:
        self.solver, self.dt = solver, dt
        self.max_joint_step: Array = solver.robot.max_joint_velocity * dt

    def __call__(
        self, command: Array, inputs: KinematicInputs, *, allow_reconfiguration: bool = True
    ) -> Move:
        """Return the commands of bases and arms.

        Args:
            command: Base commands in [-1, 1], shape (n, 3) or (n, 2).
            inputs: Of the same n rows.
            allow_reconfiguration: Whether IK also tries solutions out of reach in this period.
        """
        twist = base_twist(self.solver.robot.base, inputs.base_pose, command, self.dt)
        reached = integrate(inputs.base_pose, twist, self.dt)
        solids = inputs.solids
        arm = self.solver.solve(
            relative(inputs.desired, reached),
            inputs.joints,
            self.max_joint_step,
            allow_reconfiguration=allow_reconfiguration,
            solids=None if solids is None else in_base(solids, reached),
            posture_guide=inputs.posture_guide,
        )
        return Move(twist, arm, command)
