"""Slower EE motions, for a base with much inertia."""

from dataclasses import replace

from kinfeas.config.quantities import SLOWEST
from kinfeas.control.subgoals import ExecutionConfig
from kinfeas.core.backend import Backend
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.adapters.draws import Number


class SlowDown(Adapter):
    """Lets EE motions last longer than planned; waits do not."""

    def __init__(self, backend: Backend, robot: Robot, *, factor: Number = 2.0) -> None:
        """Wrap a backend.

        Args:
            backend: Gets all commands as they are.
            robot: Whom it moves.
            factor: How many times longer, 1 to 1000; multiplied with any other. No range: motion
                generators advance all episodes by the same time.

        Raises:
            ValueError: If it is not within these or a range.
        """
        super().__init__(backend, robot, {"factor": factor}, SLOWEST)
        if self.ranges["factor"].low < self.ranges["factor"].high:
            raise ValueError(f"factor is {factor!r}, must be one number for all episodes")

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the slower pace."""
        return replace(execution, slow_down=execution.slow_down * self.ranges["factor"].low)
