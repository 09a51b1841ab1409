"""The feasibility filter: base commands that the arm can follow."""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kinfeas.config.quantities import NotNegative
from kinfeas.control.loop import Loop
from kinfeas.control.period import KinematicInputs
from kinfeas.core.motion import Rows
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array, integrate
from kinfeas.kinematics.ik import IkSolution, spread
from kinfeas.kinematics.solids import base_collides
from kinfeas.robots.robot import exceeds_joint_velocity

_CANDIDATES = 32
_ROUNDS = ((0, 8), (8, None))
"""Ranks, nearest first, of the candidates tried in each round, until one is feasible."""


class FeasibilityFilter:
    """Replaces infeasible base commands with the nearest feasible candidate.

    A command is infeasible if IK finds no arm solution for the next control period, or none within
    the joint velocity limits and `max_deviation`, or if the base would touch a solid. Without a
    feasible candidate the command stays. No row depends on the others. Candidates satisfy the
    velocity constraints of the obstacle filters before this one.

    Args:
        max_deviation: Largest position error of an arm with a pose tolerance, metres.
    """

    speeds: ClassVar[tuple[float, ...]] = (1.0,)
    """Shares of the speed of the candidates, which are tried with each."""

    def __init__(self, max_deviation: NotNegative = 0.02) -> None:
        self.max_deviation = max_deviation

    def reset(self, loop: Loop, rows: NDArray[np.intp]) -> None:
        """Use the kinematics of a loop; arguments as in `CommandFilter`."""
        self._loop, self._robot = loop, loop.robot
        fast = 2.0 * spread(_CANDIDATES, loop.command_size) - 1.0
        self.candidates: Array = np.concatenate([speed * fast for speed in self.speeds])

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return feasible commands where there are any; arguments as in `CommandFilter`."""
        period = self._loop.period
        twist, arm, good = self._follow(command, period)
        late = (~good).nonzero()[0]
        if late.size:
            command = command.copy()
            self._replace(command, late if period.paused is None else late[~period.paused[late]])
            twist[late], found = self._loop.kinematic_step(command[late], period.of(late))
            arm.put(late, found)
        period.solved = command, twist, arm
        return command

    def _replace(self, command: Array, rows: Rows) -> Rows:
        """Put the nearest feasible candidates into some rows of the commands, shape (n, a).

        Rows without a feasible candidate are returned.
        """
        constraints = self._loop.period.velocity_constraints
        away = np.linalg.norm(self.candidates - command[rows, np.newaxis], axis=2)
        order = away.argsort(axis=1, kind="stable")
        for first, last in _ROUNDS:
            if not rows.size:
                break
            tries = self.candidates[order[:, first:last]]
            if constraints is not None:
                tries = constraints.of(rows).hold(tries)
            feasible = self._feasible(tries, rows)
            found = feasible.any(axis=1)
            command[rows[found]] = tries[found, feasible[found].argmax(axis=1)]
            rows, order = rows[~found], order[~found]
        return rows

    def _feasible(self, tries: Array, rows: Rows) -> NDArray[np.bool_]:
        """Return whether commands of m rows, shape (m, k, a), are feasible, shape (m, k)."""
        m, k, size = tries.shape
        inputs = self._loop.period.of(rows.repeat(k))
        return self._follow(tries.reshape(m * k, size), inputs)[2].reshape(m, k)

    def _follow(
        self, command: Array, inputs: KinematicInputs
    ) -> tuple[Array, IkSolution, NDArray[np.bool_]]:
        """Return twists, arms and feasibility, shape (m,), of one command for each of m rows."""
        step = self._loop.kinematic_step
        twist, arm = step(command, inputs, allow_reconfiguration=False)
        good = self._in_time(inputs.joints, arm)
        if inputs.solids is not None:
            reached = integrate(inputs.base_pose, twist, step.dt)
            good &= ~base_collides(step.solver.collision, reached, inputs.solids)
        return twist, arm, good

    def _in_time(self, joints: Array, arm: IkSolution) -> NDArray[np.bool_]:
        jumps = exceeds_joint_velocity(self._robot, joints, arm.joint_positions, self._loop.dt)
        return arm.feasible & ~jumps & (arm.position_error <= self.max_deviation)
