"""A base that yields to its arm."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinfeas import spatial
from kinfeas.drive import action_size, base_twist
from kinfeas.joints import jumps
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.spread import spread
from kinfeas.spatial import Array

_OTHERS = 32
"""Commands that are tried where the arm cannot follow; the first is to stand still."""


class Yielding:
    """Takes base commands aside that the arm could not follow for the next control period.

    Where IK finds no solution that the arm reaches in time, the nearest of a few fixed commands
    takes the command's place for which it finds one; without any, the command stays. No row depends
    on the others.
    """

    def __init__(self, solver: IkSolver, dt: float) -> None:
        """Set out the commands to try.

        Args:
            solver: The robot's kinematics.
            dt: Control period in seconds.
        """
        self._robot, self._dt = solver.robot, dt
        # From where the arm is, and from nowhere else.
        options = replace(solver.options, restarts=0, library=1)
        self._solver = IkSolver(solver.robot, options)
        self._moves = solver.robot.max_joint_velocity * dt
        self._others = 2.0 * spread(_OTHERS, action_size(solver.robot.base)) - 1.0
        self._others[0] = 0.0

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
        follows = self._follows(action, base_pose, desired, joints)
        rows = np.flatnonzero(~follows if held is None else ~(follows | held))
        if not rows.size:
            return action
        # Every row with every command, a block of rows for each command.
        tries = np.repeat(self._others, len(rows), axis=0)
        again = [np.tile(values[rows], (_OTHERS, 1)) for values in (base_pose, desired, joints)]
        follows = self._follows(tries, *again).reshape(_OTHERS, len(rows))
        away = np.linalg.norm(self._others[:, np.newaxis] - action[rows], axis=2)
        away[~follows] = np.inf
        yields = follows.any(axis=0)
        taken = action.copy()
        taken[rows[yields]] = self._others[away.argmin(axis=0)[yields]]
        return taken

    def _follows(
        self, action: Array, base_pose: Array, desired: Array, joints: Array
    ) -> NDArray[np.bool_]:
        """Return whether the arm can be in time where the commands need it, shape (n,)."""
        twist = base_twist(self._robot.base, base_pose, action, self._dt)
        target = spatial.relative(desired, spatial.integrate(base_pose, twist, self._dt))
        arm = self._solver.solve(target, joints, self._moves)
        return arm.feasible & ~jumps(self._robot, joints, arm.joint_positions, self._dt)
