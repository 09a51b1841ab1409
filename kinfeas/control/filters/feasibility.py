"""The feasibility filter: base commands that the arm can follow."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.drive import action_size
from kinfeas.control.filters.obstacles import VelocityConstraints
from kinfeas.control.kinematic_step import KinematicStep
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolution, spread
from kinfeas.robots.robot import joint_jumps

_CANDIDATES = 32
"""Commands that are tried where the arm cannot follow."""

_ROUNDS = ((0, 8), (8, _CANDIDATES))
"""Of the commands, nearest first: those that are tried where none before them was found."""


class FeasibilityFilter:
    """Replaces base commands that the arm could not follow in the next control period.

    Where IK finds no solution that the arm reaches in time, the nearest of a few fixed commands
    takes the command's place for which it finds one; without any, the command stays. No row depends
    on the others.

    Attributes:
        candidates: The commands that are tried, shape (32, a); the first is to stand still.
    """

    def __init__(self, kinematic_step: KinematicStep) -> None:
        """Set out the commands to try."""
        self._kinematic_step, self._robot = kinematic_step, kinematic_step.solver.robot
        self.candidates = 2.0 * spread(_CANDIDATES, action_size(self._robot.base)) - 1.0

    def __call__(
        self,
        action: Array,
        base_pose: Array,
        desired: Array,
        joints: Array,
        paused: NDArray[np.bool_] | None = None,
        limits: VelocityConstraints | None = None,
    ) -> tuple[Array, IkSolution]:
        """Return base twists and arm solutions for the feasible commands nearest to `action`.

        Args:
            action: Wanted base commands; these and the others are as for `KinematicStep`.
            base_pose: World pose of the base.
            desired: World pose of the EE at the end of the period.
            joints: Arm joints that were last commanded.
            paused: Rows that stand still and are left alone, shape (n,); none by default.
            limits: What the commands that are tried keep; `action` keeps it already.
        """
        twist, arm = self._kinematic_step(
            action, base_pose, desired, joints, allow_reconfiguration=False
        )
        late = np.flatnonzero(~self._in_time(joints, arm))
        if late.size:
            stands = (base_pose[late], desired[late], joints[late])
            free = np.ones(late.size, dtype=bool) if paused is None else ~paused[late]
            within = None if limits is None else limits.of(late)
            aside = self._aside(action[late], stands, np.flatnonzero(free), within)
            twist[late], found = self._kinematic_step(aside, *stands)
            arm.put(late, found)
        return twist, arm

    def _aside(
        self,
        action: Array,
        stands: tuple[Array, Array, Array],
        rows: NDArray[np.intp],
        limits: VelocityConstraints | None,
    ) -> Array:
        """Return other commands for some of m rows, and the same for others or where none helps.

        Args:
            action: Commands that the arm cannot follow, shape (m, a).
            stands: Base poses, desired poses and arm joints.
            rows: Of these, who may have another command.
            limits: What others keep, or none.
        """
        taken = action.copy()
        away = np.linalg.norm(self.candidates - action[rows, np.newaxis], axis=2)
        order = away.argsort(axis=1, kind="stable")
        for first, last in _ROUNDS:
            if not rows.size:
                break
            tries = self.candidates[order[:, first:last]]
            if limits is not None:
                tries = limits.of(rows).hold(tries)
            follows = self._follows(tries, *(values[rows] for values in stands))
            feasibility_filter = follows.any(axis=1)
            taken[rows[feasibility_filter]] = tries[
                feasibility_filter, follows[feasibility_filter].argmax(axis=1)
            ]
            rows, order = rows[~feasibility_filter], order[~feasibility_filter]
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
        stands = [values.repeat(k, axis=0) for values in (base_pose, desired, joints)]
        _, arm = self._kinematic_step(
            tries.reshape(m * k, size), *stands, allow_reconfiguration=False
        )
        return self._in_time(stands[-1], arm).reshape(m, k)

    def _in_time(self, joints: Array, arm: IkSolution) -> NDArray[np.bool_]:
        return arm.feasible & ~joint_jumps(
            self._robot, joints, arm.joint_positions, self._kinematic_step.dt
        )
