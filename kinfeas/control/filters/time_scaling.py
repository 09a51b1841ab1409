"""Time scaling: the EE slows down or waits where no base command lets the arm follow."""

import numpy as np

from kinfeas.config.quantities import NotNegative
from kinfeas.control.filters.feasibility import FeasibilityFilter
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array

_SHARES = (0.5, 0.25, 0.0)
"""Shares of the planned step that are tried, until there is a feasible command."""


class TimeScalingFilter(FeasibilityFilter):
    """Replaces infeasible base commands as the feasibility filter, and slows down the EE.

    Candidates have three speeds. Where none is feasible for the whole step of the EE, those for a
    part of it are tried, at last those for a resting EE, while the base moves on. Without any, base
    and arm hold. Thus no IK failure and no joint jump is commanded. It must be the last filter.

    Args:
        max_deviation: As of the feasibility filter; the EE waits where no candidate is within it.
    """

    # Near joint limits the arm only follows a slow base.
    speeds = (1.0, 0.3, 0.1)

    def __init__(self, max_deviation: NotNegative = 0.01) -> None:
        super().__init__(max_deviation)

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return feasible commands; arguments as in `CommandFilter`."""
        loop, period, command = self._loop, self._loop.period, command.copy()
        twist, arm, good = self._follow(command, period)
        late = np.flatnonzero(~good)
        if period.paused is not None:
            late = late[~period.paused[late]]
        if late.size:
            planned = period.time_scale
            scale, left = planned.copy(), self._replace(command, late)
            for share in _SHARES:
                if not left.size:
                    break
                scale[left] = share * planned[left]
                loop.slow_down(scale.copy())
                slow = left[~self._feasible(command[left, np.newaxis], left)[:, 0]]
                left = self._replace(command, slow)
            command[left] = 0.0
            twist[late], found = loop.kinematic_step(
                command[late], period.of(late), allow_reconfiguration=False
            )
            arm.put(late, found)
        period.solved = command, twist, arm
        return command
