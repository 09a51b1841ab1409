"""The arms of n robots: their commands, and pauses while they reconfigure."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.period import KinematicStep, Move, Period
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import exceeds_joint_velocity

RECONFIGURATION_SECONDS = 0.15
"""An arm further from its command than this time at full joint velocity is reconfiguring, rather
than lagging."""


class Arm:
    """Arms that follow their bases.

    Attributes:
        joint_command: Last commanded arm joints, shape (n, j), radians or metres.
        waited: Control periods for which each arm has been reconfiguring, shape (n,).
    """

    def __init__(self, solver: IkSolver, dt: float, settle_timeout: float) -> None:
        """Command arms in periods of `dt` seconds; pauses last `settle_timeout` seconds at most."""
        self._step, self._robot = KinematicStep(solver, dt), solver.robot
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
