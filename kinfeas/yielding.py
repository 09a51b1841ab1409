"""A base that yields to its arm."""

import numpy as np
from numpy.typing import NDArray

from kinfeas import spatial
from kinfeas.drive import action_size, base_twist
from kinfeas.joints import jumps
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.spread import spread
from kinfeas.spatial import Array

_OTHERS = 32
"""Commands that are tried where the arm cannot follow."""

_ROUNDS = ((0, 8), (8, _OTHERS))
"""Of the commands, nearest first: those that are tried where none before them was found."""


class Yielding:
    """Takes base commands aside that the arm could not follow for the next control period.

    Where IK finds no solution that the arm reaches in time, the nearest of a few fixed commands
    takes the command's place for which it finds one; without any, the command stays. No row depends
    on the others.

    Attributes:
        others: The commands that are tried, shape (32, a); the first is to stand still.
    """

    def __init__(self, solver: IkSolver, dt: float) -> None:
        """Set out the commands to try.

        Args:
            solver: The robot's kinematics.
            dt: Control period in seconds.
        """
        self._solver, self._robot, self._dt = solver, solver.robot, dt
        self._moves = solver.robot.max_joint_velocity * dt
        self.others = 2.0 * spread(_OTHERS, action_size(solver.robot.base)) - 1.0
        self.others[0] = 0.0

    def aside(
        self,
        action: Array,
        base_pose: Array,
        desired: Array,
        joints: Array,
        held: NDArray[np.bool_] | None = None,
    ) -> Array:
        """Return the commands that come nearest to `action` and that the arm can follow.

        Args:
            action: Wanted base commands in [-1, 1], shape (n, 3) or (n, 2).
            base_pose: World pose of the base, shape (n, 7).
            desired: World pose of the EE at the end of the period, shape (n, 7).
            joints: Arm joints that were last commanded, shape (n, j), radians or metres.
            held: Rows that stand still and are left alone, shape (n,); none by default.

        Returns:
            Of the shape of `action`.
        """
        follows = self._follows(action[:, np.newaxis], base_pose, desired, joints)[:, 0]
        rows = np.flatnonzero(~follows if held is None else ~(follows | held))
        if not rows.size:
            return action
        taken = action.copy()
        away = np.linalg.norm(self.others - action[rows, np.newaxis], axis=2)
        order = away.argsort(axis=1, kind="stable")
        for first, last in _ROUNDS:
            tries = self.others[order[:, first:last]]
            follows = self._follows(tries, base_pose[rows], desired[rows], joints[rows])
            yields = follows.any(axis=1)
            taken[rows[yields]] = tries[yields, follows[yields].argmax(axis=1)]
            rows, order = rows[~yields], order[~yields]
        return taken

    def _follows(
        self, tries: Array, base_pose: Array, desired: Array, joints: Array
    ) -> NDArray[np.bool_]:
        """Return whether the arm can be in time where commands need it, shape (m, k).

        Args:
            tries: k commands for each of m rows, shape (m, k, a).
            base_pose: Of these rows, as are the others, shape (m, 7).
            desired: Shape (m, 7).
            joints: Shape (m, j).
        """
        m, k, size = tries.shape
        base_pose, desired, joints = (
            values.repeat(k, axis=0) for values in (base_pose, desired, joints)
        )
        twist = base_twist(self._robot.base, base_pose, tries.reshape(m * k, size), self._dt)
        target = spatial.relative(desired, spatial.integrate(base_pose, twist, self._dt))
        arm = self._solver.solve(target, joints, self._moves, swings=False)
        follows = arm.feasible & ~jumps(self._robot, joints, arm.joint_positions, self._dt)
        return follows.reshape(m, k)
