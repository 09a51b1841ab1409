"""Time scaling: the EE slows down or waits where no base command lets the arm follow."""

from typing import NamedTuple

import numpy as np

from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.control.period import Period
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.quantities import NotNegative
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkSolver

_FRACTIONS = (0.5, 0.25, 0.0)
"""Fractions of the planned step that are tried, until there is a feasible command."""

_MOST_DEVIATION = 3.0
"""Multiple of `max_deviation` with which the first fraction is tried again for arms with a pose
tolerance: IK may exceed the limit even at rest, to reduce the rotation error, and wait for ever."""

_STUCK = 0.3
"""Fraction of the planned step where none is feasible, for robots that respond late: at rest, their
bases would stop somewhere else."""


class SlowAttempt(NamedTuple):
    """One attempt to find feasible commands."""

    fraction: float  # of the planned step; 0 for rest
    max_deviation: float  # largest position error of the arm, metres


class TimeScalingFilter(FeasibilityFilter):
    """Replaces infeasible base commands as the feasibility filter, and slows down the EE.

    Candidates have three speeds. If none is feasible for the whole step of the EE, half and a
    quarter of the step are tried, then rest: the EE waits, and the feasible candidate is taken
    whose arm comes nearest to the end of the whole step. Last are candidates with more deviation.
    Without any, base and arm hold. So no IK failure and no joint jump is commanded to robots that
    respond at once; commands of others are tried half a second ahead. It must be the last filter.

    Args:
        solver: IK of the robot.
        dt: Control period, seconds.
        response: Response of the robot.
        max_deviation: As in the feasibility filter; three times as much where the EE would wait.
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
        self._at_once = self._periods == 1.0
        self._attempts = [SlowAttempt(fraction, max_deviation) for fraction in _FRACTIONS]
        if response.immediate and solver.robot.pose_tolerance is not None:
            self._attempts.append(SlowAttempt(_FRACTIONS[0], _MOST_DEVIATION * max_deviation))

    def __call__(self, period: Period) -> Period:
        """Return the period with feasible commands, and slower where there are none."""
        planned, command = period.time_scale, period.command.copy()
        whole = self.ahead(period)
        move, good = self._tried(period.command, whole, self.max_deviation)
        failed = (~good).nonzero()[0]
        if period.paused is not None:
            failed = failed[~period.paused[failed]]
        unsolved = self._replace(whole, command, failed, self.max_deviation)
        for attempt in self._attempts:
            if unsolved.size:
                period = _slowed(period, unsolved, attempt.fraction * planned[unsolved])
                unsolved = self._try(attempt, period, whole, command, unsolved)
        if unsolved.size:
            if self._at_once:
                command[unsolved] = 0.0
            fraction = 0.0 if self._at_once else _STUCK
            period = _slowed(period, unsolved, fraction * planned[unsolved])
        return self._moved(period, command, failed, move, allow_reconfiguration=False)

    def _try(
        self, attempt: SlowAttempt, period: Period, whole: Period, command: Array, rows: Rows
    ) -> Rows:
        """Put feasible commands for a slower period into some rows; return those without any."""
        if attempt.fraction == 0.0 and self._at_once:
            return self._rest(period, whole, command, rows)
        ahead, limit = self.ahead(period), attempt.max_deviation
        good = self._feasible(ahead, command[rows, np.newaxis], rows, limit)[:, 0]
        return self._replace(ahead, command, rows[~good], limit)

    def _rest(self, period: Period, whole: Period, command: Array, rows: Rows) -> Rows:
        """Put candidates for a resting EE into some rows of the commands, shape (n, a).

        Those whose arms come nearest to the end of the `whole` step are taken. With the nearest to
        the policy's command, a base might rest for ever. Rows without a feasible one are returned.
        """
        m, k = len(rows), len(self.candidates)
        tries = np.tile(self.candidates, (m, 1, 1))
        if period.velocity_constraints is not None:
            tries = period.velocity_constraints.of(rows).hold(tries)
        feasible = self._feasible(period, tries, rows, self.max_deviation)
        ends = whole.of(rows.repeat(k))
        arm = self._tried(tries.reshape(m * k, -1), ends, self.max_deviation)[0].arm
        errors = arm.position_error + ROTATION_WEIGHT * arm.rotation_error
        best = np.where(feasible, errors.reshape(m, k), np.inf).argmin(axis=1)
        solved = feasible.any(axis=1)
        command[rows[solved]] = tries[solved, best[solved]]
        return rows[~solved]


def _slowed(period: Period, rows: Rows, time_scale: Array) -> Period:
    """Return the period with other fractions of the planned motion in some rows."""
    return period.slowed(with_rows(period.time_scale, rows, time_scale))
