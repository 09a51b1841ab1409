"""Time scaling: the EE slows down or waits where no base command lets the arm follow."""

from copy import copy

import numpy as np

from kinfeas.config.quantities import NotNegative
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.period import Period
from kinfeas.core.response import ResponseModel
from kinfeas.kinematics.ik import IkSolver

_FRACTIONS = (0.5, 0.25, 0.0)
"""Fractions of the planned step that are tried, until there is a feasible command."""

_MOST_DEVIATION = 3.0
"""Multiple of `max_deviation` with which the first fraction is tried again, of arms with a pose
tolerance. Even at rest IK may exceed the limit to reduce the rotation error: a lasting wait."""

_STUCK = 0.3
"""Fraction of the planned step where none is feasible, of robots that respond late: on hold, their
bases would come to rest somewhere else."""


class TimeScalingFilter(FeasibilityFilter):
    """Replaces infeasible base commands as the feasibility filter, and slows down the EE.

    Candidates have three speeds. Where none is feasible for the whole step of the EE, those for a
    part of it are tried, then those for a resting EE, while the base moves on, at last those with
    more deviation. Without any, base and arm hold. Thus no IK failure and no joint jump is
    commanded. It must be the last filter.

    Args:
        solver: IK of the robot.
        dt: Control period, seconds.
        response: Response of the robot.
        max_deviation: As of the feasibility filter; three times as much where the EE would wait.
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
        self._tries: list[tuple[float, FeasibilityFilter]] = [(part, self) for part in _FRACTIONS]
        if response.immediate and solver.robot.pose_tolerance is not None:
            lenient = copy(self)
            lenient.max_deviation *= _MOST_DEVIATION
            self._tries.append((_FRACTIONS[0], lenient))

    def __call__(self, period: Period) -> Period:
        """Return the period with feasible commands, and slower where there are none."""
        ahead = self.ahead(period)
        move, good = self._tried(period.command, ahead)
        failed = (~good).nonzero()[0]
        if period.paused is not None:
            failed = failed[~period.paused[failed]]
        planned, command = period.time_scale, period.command.copy()
        scale, left = planned.copy(), self._replace(ahead, command, failed)
        for fraction, judge in self._tries:
            if not left.size:
                break
            scale[left] = fraction * planned[left]
            period = period.slowed(scale.copy())
            ahead = self.ahead(period)
            slow = left[~judge._feasible(ahead, command[left, np.newaxis], left)[:, 0]]
            left = judge._replace(ahead, command, slow)
        if left.size and ahead is period:
            scale[left], command[left] = 0.0, 0.0
            period = period.slowed(scale)
        elif left.size:
            scale[left] = _STUCK * planned[left]
            period = period.slowed(scale)
        return self._moved(period, command, failed, move, allow_reconfiguration=False)
