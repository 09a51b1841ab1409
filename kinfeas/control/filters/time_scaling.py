"""Time scaling: the EE slows down or waits where no base command lets the arm follow."""

import numpy as np

from kinfeas.config.quantities import NotNegative
from kinfeas.control.filters.feasibility import FeasibilityFilter, replaced
from kinfeas.control.period import Period
from kinfeas.core.response import ResponseModel
from kinfeas.kinematics.ik import IkSolver

_FRACTIONS = (0.5, 0.25, 0.0)
"""Fractions of the planned step that are tried, until there is a feasible command."""


class TimeScalingFilter(FeasibilityFilter):
    """Replaces infeasible base commands as the feasibility filter, and slows down the EE.

    Candidates have three speeds. Where none is feasible for the whole step of the EE, those for a
    part of it are tried, at last those for a resting EE, while the base moves on. Without any, base
    and arm hold. Thus no IK failure and no joint jump is commanded. It must be the last filter.

    Args:
        solver: IK of the robot.
        dt: Control period, seconds.
        response: Response of the robot.
        max_deviation: As of the feasibility filter; the EE waits where no candidate is within it.
    """

    # Near joint limits the arm only follows a slow base.
    speeds = (1.0, 0.3, 0.1)

    def __init__(
        self,
        solver: IkSolver,
        dt: float,
        response: ResponseModel,
        max_deviation: NotNegative = 0.01,
    ) -> None:
        super().__init__(solver, dt, response, max_deviation)

    def __call__(self, period: Period) -> Period:
        """Return the period with feasible commands, and slower where there are none."""
        move, good = self._tried(period.command, period)
        failed = (~good).nonzero()[0]
        if period.paused is not None:
            failed = failed[~period.paused[failed]]
        if not failed.size:
            return period.changed(move=move)
        planned, command = period.time_scale, period.command.copy()
        scale, left = planned.copy(), self._replace(period, command, failed)
        for fraction in _FRACTIONS:
            if not left.size:
                break
            scale[left] = fraction * planned[left]
            period = period.slowed(scale.copy())
            slow = left[~self._feasible(period, command[left, np.newaxis], left)[:, 0]]
            left = self._replace(period, command, slow)
        command[left] = 0.0
        retried = self._step(command[failed], period.of(failed), allow_reconfiguration=False)
        return period.changed(command=command, move=replaced(move, failed, retried, command))
