"""Slower EE motions, for a base with much inertia."""

from dataclasses import replace

from kinfeas.config.quantities import TIME_SCALES
from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.backend import Backend
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.adapters.draws import Number


class TimeScale(Adapter):
    """Slower EE motions than planned; dwells keep their time."""

    def __init__(self, backend: Backend, robot: Robot, *, factor: Number = 0.5) -> None:
        """Wrap a backend.

        Args:
            backend: Gets all commands as they are.
            robot: Whom it moves.
            factor: Share of the planned speed, 0.001 to 1; multiplied with any other. No range:
                all episodes advance by the same time.

        Raises:
            ValueError: If it is not within these or a range.
        """
        super().__init__(backend, robot, {"factor": factor}, TIME_SCALES)
        if self.ranges["factor"].low < self.ranges["factor"].high:
            raise ValueError(f"factor is {factor!r}, must be one number for all episodes")

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the slower execution."""
        return replace(execution, time_scale=execution.time_scale * self.ranges["factor"].low)
