"""One control period of n robots: what is asked of them, and arms that follow their bases."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.motion_sequence import Plan
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, integrate, relative
from kinfeas.kinematics.drive import base_twist
from kinfeas.kinematics.ik import IkSolution, IkSolver
from kinfeas.kinematics.solids import in_base


@dataclass(kw_only=True)
class KinematicInputs:
    """What bases and arms begin and end a control period with.

    Attributes:
        base_pose: World pose of the base at the beginning, shape (n, 7).
        joints: Arm joints at which IK begins, shape (n, j), radians or metres: the last command,
            with the torso where the action moves it.
        desired: World pose of the EE at the end, shape (n, 7).
        solids: World solids at the end, n rows, which the arms avoid.
        guide: Arm joints that IK prefers, shape (n, j); NaN for none.
    """

    base_pose: Array
    joints: Array
    desired: Array
    solids: Solids | None = None
    guide: Array | None = None

    def of(self, rows: NDArray[np.intp]) -> "KinematicInputs":
        """Return the inputs of some rows."""
        return KinematicInputs(
            base_pose=self.base_pose[rows],
            joints=self.joints[rows],
            desired=self.desired[rows],
            solids=None if self.solids is None else self.solids.of(rows),
            guide=None if self.guide is None else self.guide[rows],
        )


@dataclass(kw_only=True)
class Period(KinematicInputs):
    """A control period that a step is about to carry out; filters read it and change it.

    Attributes:
        plan: Step of the motions. Change it by `Loop.slow_down`.
        time_scale: Share of the planned motion that it makes, shape (n,).
        paused: Whether base and motion pause while the arm reconfigures, shape (n,); None if none
            does.
        velocity_constraints: What an obstacle filter allows the bases, for the filters after it.
        solved: A command with its base twists and IK solution, where a filter has computed them.
    """

    plan: Plan
    time_scale: Array
    paused: NDArray[np.bool_] | None = None
    velocity_constraints: Any = None
    solved: tuple[Array, Array, IkSolution] | None = None

    @property
    def motion_seconds(self) -> Array:
        """Motion time of the step, seconds, shape (n,)."""
        seconds = self.plan.seconds
        return seconds if self.paused is None else np.where(self.paused, 0.0, seconds)

    def unless_paused(self, command: Array) -> Array:
        """Return commands, shape (n, a), that are zero in paused rows."""
        if self.paused is None:
            return command
        return np.where(self.paused[:, np.newaxis], 0.0, command)


class KinematicStep:
    """Effect of base commands in one control period: base twists, and arms by IK.

    Attributes:
        solver: IK of the robot.
        dt: Control period in seconds.
        max_joint_step: Longest way of each arm joint in a period, shape (j,), radians or metres.
        hold_torso: Whether the torso stays where the joints have it.
    """

    hold_torso: bool = False

    def __init__(self, solver: IkSolver, dt: float) -> None:
        self.solver, self.dt = solver, dt
        self.max_joint_step: Array = solver.robot.max_joint_velocity * dt

    def __call__(
        self, action: Array, inputs: KinematicInputs, *, allow_reconfiguration: bool = True
    ) -> tuple[Array, IkSolution]:
        """Return world twists of the bases, shape (n, 6), and IK solutions of the arms.

        Args:
            action: Base commands in [-1, 1], shape (n, 3) or (n, 2).
            inputs: Of the same n rows.
            allow_reconfiguration: Whether IK also tries solutions out of reach in this period.
        """
        twist = base_twist(self.solver.robot.base, inputs.base_pose, action, self.dt)
        reached = integrate(inputs.base_pose, twist, self.dt)
        solids = inputs.solids
        return twist, self.solver.solve(
            relative(inputs.desired, reached),
            inputs.joints,
            self.max_joint_step,
            allow_reconfiguration=allow_reconfiguration,
            solids=None if solids is None else in_base(solids, reached),
            hold_torso=self.hold_torso,
            posture_guide=inputs.guide,
        )
