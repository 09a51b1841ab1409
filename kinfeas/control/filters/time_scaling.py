"""Time scaling: the EE slows down or waits where no base command lets the arm follow."""

from typing import NamedTuple

import numpy as np

from kinfeas.control.filters.feasibility import HORIZON, FeasibilityFilter, allowed
from kinfeas.control.period import KinematicStep, Period
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.quantities import NotNegative
from kinfeas.core.response import ResponseModel
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import ROTATION_WEIGHT, IkSolver
from kinfeas.kinematics.solids import collides
from kinfeas.robots.robot import joint_displacement

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
    Without any, an arm that can be at the resting EE within half a second, as after a jump of the
    localisation, moves toward it; otherwise base and arm hold. So no joint jump is commanded to
    robots that respond at once, and no IK failure unless their bases were displaced; commands of
    others are tried half a second ahead. It must be the last filter.

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
        self._later = KinematicStep(solver, max(HORIZON, dt), response)
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
        joints = period.joints[unsolved]
        if unsolved.size:
            fraction = 0.0 if self._at_once else _STUCK
            period = _slowed(period, unsolved, fraction * planned[unsolved])
            if self._at_once:
                command[unsolved], joints = self._catch_up(period, unsolved)
        period = self._moved(period, command, failed, move, allow_reconfiguration=False)
        if period.move is not None:
            arm = period.move.arm
            behind = ~arm.feasible[unsolved]
            arm.joint_positions[unsolved[behind]] = joints[behind]
        return period

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
        tries = allowed(np.tile(self.candidates, (m, 1, 1)), period, rows)
        feasible = self._feasible(period, tries, rows, self.max_deviation)
        ends = whole.of(rows.repeat(k))
        arm = self._tried(tries.reshape(m * k, -1), ends, self.max_deviation)[0].arm
        errors = arm.position_error + ROTATION_WEIGHT * arm.rotation_error
        best = np.where(feasible, errors.reshape(m, k), np.inf).argmin(axis=1)
        solved = feasible.any(axis=1)
        command[rows[solved]] = tries[solved, best[solved]]
        return rows[~solved]

    def _catch_up(self, period: Period, rows: Rows) -> tuple[Array, Array]:
        """Return base commands, (m, a), and joints, (m, j), toward the resting EE of some rows.

        The joints are on the way to where the arm is at the EE half a second later. Of the base
        commands that allow this, rest comes first, then the slowest; for arms with a pose tolerance
        those with the least error. Where there is none, or the arm would touch something, base and
        arm hold.
        """
        rest, slowest_first = np.zeros_like(self.candidates[:1]), self.candidates[::-1]
        tries = np.tile(np.vstack([rest, slowest_first]), (len(rows), 1, 1))
        tries = allowed(tries, period, rows)
        m, k, size = tries.shape
        inputs, now = period.of(rows.repeat(k)), period.of(rows)
        moves, good = self._tried(tries.reshape(m * k, size), inputs, np.inf, self._later)
        errors = np.maximum(moves.arm.position_error, self.max_deviation)
        best = np.where(good, errors, np.inf).reshape(m, k).argmin(axis=1) + k * np.arange(m)
        later = moves.arm.joint_positions[best]
        displacement = joint_displacement(self._robot, now.joints, later)
        periods = (np.abs(displacement) / self._step.max_joint_step).max(axis=1).clip(min=1.0)
        joints = now.joints + displacement / periods[:, np.newaxis]
        able = good[best] & self._step.solver.admissible(joints)
        if now.solids is not None:
            collision = self._step.solver.collision
            able &= ~collides(collision, joints, now.base_pose, now.solids).any(axis=1)
        able = able[:, np.newaxis]
        command = np.where(able, tries.reshape(m * k, size)[best], 0.0)
        return command, np.where(able, joints, now.joints)


def _slowed(period: Period, rows: Rows, time_scale: Array) -> Period:
    """Return the period with other fractions of the planned motion in some rows."""
    return period.slowed(with_rows(period.time_scale, rows, time_scale))
