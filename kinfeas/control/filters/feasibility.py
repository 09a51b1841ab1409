"""The feasibility filter: base commands that the arm can follow."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.period import KinematicInputs, KinematicStep, Move, Period
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.quantities import NotNegative
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.kinematics.drive import command_size
from kinfeas.kinematics.ik import IkSolver, spread
from kinfeas.kinematics.solids import base_collides
from kinfeas.robots.robot import exceeds_joint_velocity

_CANDIDATES = 32
HORIZON = 0.5
"""Seconds in which a base that responds late shows the effect of a command."""

_ROUNDS = ((0, 8), (8, None))
"""Ranks, nearest first, of the candidates tried in each round, until one is feasible."""


class FeasibilityFilter:
    """Replaces infeasible base commands with the nearest feasible candidate.

    A command is infeasible if IK finds no arm solution for the next control period, or none within
    the joint velocity limits and `max_deviation`, or if the base would touch a solid. Without a
    feasible candidate the command stays. No row depends on the others. Candidates satisfy the
    velocity constraints of the obstacle filters before this one.

    Args:
        solver: IK of the robot.
        dt: Control period, seconds.
        response: Response of the robot.
        max_deviation: Largest position error of an arm with a pose tolerance, metres.
    """

    speeds: ClassVar[tuple[float, ...]] = (1.0,)
    """Factors of the candidates' speed; each one makes a full set of candidates."""

    def __init__(
        self,
        solver: IkSolver,
        dt: float,
        response: ResponseModel,
        max_deviation: NotNegative = 0.02,
    ) -> None:
        self.max_deviation = max_deviation
        self._step, self._robot = KinematicStep(solver, dt, response), solver.robot
        self._periods = 1.0 if response.immediate else max(HORIZON / dt, 1.0)
        self._ahead = KinematicStep(solver, self._periods * dt, response)
        fast = 2.0 * spread(_CANDIDATES, command_size(solver.robot.base)) - 1.0
        self.candidates: Array = np.concatenate([speed * fast for speed in self.speeds])

    def __call__(self, period: Period) -> Period:
        """Return the period with feasible commands where there are any."""
        ahead = self.ahead(period)
        move, good = self._tried(period.command, ahead, self.max_deviation)
        failed, command = (~good).nonzero()[0], period.command
        if failed.size:
            free = failed if period.paused is None else failed[~period.paused[failed]]
            command = command.copy()
            self._replace(ahead, command, free, self.max_deviation)
        return self._moved(period, command, failed, move)

    def ahead(self, period: Period) -> Period:
        """Return the period in which commands are tried: a longer one if robots respond late."""
        if self._periods == 1.0:
            return period
        step = period.motions.step_of(period.motion_seconds * self._periods)
        return period.changed(desired=step.desired)

    def _moved(
        self, period: Period, command: Array, changed: Rows, move: Move, *,
        allow_reconfiguration: bool = True,
    ) -> Period:  # fmt: skip
        """Return the period with commands that differ from those of `move` in `changed` rows."""
        if self._periods > 1.0:
            return period.changed(command=command, move=None)
        if changed.size:
            retried = self._step(
                command[changed], period.of(changed), allow_reconfiguration=allow_reconfiguration
            )
            move = replaced(move, changed, retried, command)
        return period.changed(command=command, move=move)

    def _replace(self, period: Period, command: Array, rows: Rows, max_deviation: float) -> Rows:
        """Put the nearest feasible candidates into some rows of the commands, shape (n, a).

        Rows without a feasible candidate are returned.
        """
        distances = np.linalg.norm(self.candidates - command[rows, np.newaxis], axis=2)
        order = distances.argsort(axis=1, kind="stable")
        for first, last in _ROUNDS:
            if not rows.size:
                break
            tries = allowed(self.candidates[order[:, first:last]], period, rows)
            feasible = self._feasible(period, tries, rows, max_deviation)
            solved = feasible.any(axis=1)
            command[rows[solved]] = tries[solved, feasible[solved].argmax(axis=1)]
            rows, order = rows[~solved], order[~solved]
        return rows

    def _feasible(
        self, period: Period, tries: Array, rows: Rows, max_deviation: float
    ) -> NDArray[np.bool_]:
        """Return whether commands of m rows, shape (m, k, a), are feasible, shape (m, k)."""
        m, k, size = tries.shape
        inputs = period.of(rows.repeat(k))
        good = self._tried(tries.reshape(m * k, size), inputs, max_deviation)[1]
        return good.reshape(m, k)

    def _tried(
        self, command: Array, inputs: KinematicInputs, max_deviation: float,
        step: KinematicStep | None = None,
    ) -> tuple[Move, NDArray[np.bool_]]:  # fmt: skip
        """Return the moves of commands, one for each of m rows, and whether they are feasible."""
        step = step or self._ahead
        move = step(command, inputs, allow_reconfiguration=False)
        jump = exceeds_joint_velocity(self._robot, inputs.joints, move.arm.joint_positions, step.dt)
        good = move.arm.feasible & ~jump & (move.arm.position_error <= max_deviation)
        if inputs.solids is not None:
            good &= ~base_collides(step.solver.collision, move.base_pose, inputs.solids)
        return move, good


def allowed(tries: Array, period: Period, rows: Rows) -> Array:
    """Return commands of m rows, shape (m, k, a), that keep the velocity constraints."""
    constraints = period.velocity_constraints
    return tries if constraints is None else constraints.of(rows).hold(tries)


def replaced(move: Move, rows: Rows, retried: Move, command: Array) -> Move:
    """Return `move` with `retried` in some rows, and the `command` of all; changes `move.arm`."""
    twist = with_rows(move.base_twist, rows, retried.base_twist)
    base_pose = with_rows(move.base_pose, rows, retried.base_pose)
    move.arm.put(rows, retried.arm)
    return Move(twist, move.arm, command, base_pose)
