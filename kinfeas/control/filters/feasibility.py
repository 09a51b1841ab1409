"""The feasibility filter: base commands that the arm can follow."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolution, spread
from kinfeas.robots.robot import exceeds_joint_velocity

_CANDIDATES = 32
_ROUNDS = ((0, 8), (8, _CANDIDATES))
"""Ranks, nearest first, of the candidates tried in each round, until one is feasible."""


class FeasibilityFilter:
    """Replaces infeasible base commands with the nearest feasible candidate.

    A command is infeasible if IK finds no arm solution for the next control period, or none within
    the joint velocity limits. Without a feasible candidate the command stays. No row depends on the
    others. Candidates satisfy the velocity constraints of the obstacle filters before this one.
    """

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Use the kinematics of a loop; arguments as in `CommandFilter`."""
        self._loop, self._robot = loop, loop.robot
        self.candidates: Array = 2.0 * spread(_CANDIDATES, loop.command_size) - 1.0

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return feasible commands where there are any; arguments as in `CommandFilter`."""
        loop = self._loop
        inputs = (loop.state.base_pose, loop.next_desired, loop.joint_command)
        twist, arm = loop.kinematic_step(command, *inputs, allow_reconfiguration=False)
        late = np.flatnonzero(~self._in_time(loop.joint_command, arm))
        if late.size:
            command = command.copy()
            inputs = tuple(values[late] for values in inputs)
            free = np.arange(late.size)
            if loop.paused is not None:
                free = np.flatnonzero(~loop.paused[late])
            self._replace(command, late, inputs, free)
            twist[late], found = loop.kinematic_step(command[late], *inputs)
            arm.put(late, found)
        loop.solved = command, twist, arm
        return command

    def _replace(
        self, command: Array, late: NDArray[np.intp], inputs: tuple[Array, ...], rows: Any
    ) -> Any:
        """Put the nearest feasible candidates into the commands of all robots, shape (n, a).

        `late` are the m robots with infeasible commands, with their base poses, desired poses and
        arm joints as `inputs`; `rows` are indices into these m of those that may get another one.
        Those without a feasible candidate are returned.
        """
        constraints = self._loop.velocity_constraints
        away = np.linalg.norm(self.candidates - command[late[rows], np.newaxis], axis=2)
        order = away.argsort(axis=1, kind="stable")
        for first, last in _ROUNDS:
            if not rows.size:
                break
            tries = self.candidates[order[:, first:last]]
            if constraints is not None:
                tries = constraints.of(late[rows]).hold(tries)
            feasible = self._feasible(tries, *(values[rows] for values in inputs))
            found = feasible.any(axis=1)
            command[late[rows[found]]] = tries[found, feasible[found].argmax(axis=1)]
            rows, order = rows[~found], order[~found]
        return rows

    def _feasible(
        self, tries: Array, base_pose: Array, desired: Array, joints: Array
    ) -> NDArray[np.bool_]:
        """Return whether the arm can follow each of k commands for m robots, shape (m, k)."""
        m, k, size = tries.shape
        inputs = [values.repeat(k, axis=0) for values in (base_pose, desired, joints)]
        _, arm = self._loop.kinematic_step(
            tries.reshape(m * k, size), *inputs, allow_reconfiguration=False
        )
        return self._in_time(inputs[-1], arm).reshape(m, k)

    def _in_time(self, joints: Array, arm: IkSolution) -> NDArray[np.bool_]:
        jumps = exceeds_joint_velocity(self._robot, joints, arm.joint_positions, self._loop.dt)
        return arm.feasible & ~jumps
