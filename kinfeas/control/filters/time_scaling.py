"""Time scaling: the EE slows down or waits where no base command lets the arm follow."""

from copy import copy

import numpy as np

from kinfeas.config.quantities import NotNegative
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.period import Period
from kinfeas.core.motion import Rows
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkSolver

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
    part of it are tried. Then the EE rests, and of the candidates the one with the arm nearest to
    the end of the whole step is taken. Last are candidates with more deviation. Without any, base
    and arm hold. Thus no IK failure and no joint jump is commanded. It must be the last filter.

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
        whole = ahead = self.ahead(period)
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
            if not fraction and ahead is period:
                left = self._rest(period, whole, command, left)
                continue
            slow = left[~judge._feasible(ahead, command[left, np.newaxis], left)[:, 0]]
            left = judge._replace(ahead, command, slow)
        if left.size and ahead is period:
            scale[left], command[left] = 0.0, 0.0
            period = period.slowed(scale)
        elif left.size:
            scale[left] = _STUCK * planned[left]
            period = period.slowed(scale)
        return self._moved(period, command, failed, move, allow_reconfiguration=False)

    def _rest(self, period: Period, whole: Period, command: Array, rows: Rows) -> Rows:
        """Put candidates for a resting EE into some rows of the commands, shape (n, a).

        Arms come nearest to the end of the `whole` step with them: near the policy's command, the
        base may rest for ever, too. Rows without a feasible candidate are returned.
        """
        m, k = len(rows), len(self.candidates)
        tries = np.tile(self.candidates, (m, 1, 1))
        if period.velocity_constraints is not None:
            tries = period.velocity_constraints.of(rows).hold(tries)
        feasible = self._feasible(period, tries, rows)
        arm = self._tried(tries.reshape(m * k, -1), whole.of(rows.repeat(k)))[0].arm
        errors = arm.position_error + ROTATION_WEIGHT * arm.rotation_error
        best = np.where(feasible, errors.reshape(m, k), np.inf).argmin(axis=1)
        found = feasible.any(axis=1)
        command[rows[found]] = tries[found, best[found]]
        return rows[~found]
