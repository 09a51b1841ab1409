"""A head start: the base moves before the EE does."""

from dataclasses import replace

from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.backend import Backend
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.adapters.draws import Number


class HeadStart(Adapter):
    """Lets the EE stand still at first, while the policy moves the base already."""

    def __init__(self, backend: Backend, robot: Robot, *, seconds: Number = 3.0) -> None:
        """Wrap a backend.

        Args:
            backend: Gets all commands as they are.
            robot: Whom it moves.
            seconds: Seconds for which the EE stands still; added to any other head start.

        Raises:
            ValueError: If it is negative or not finite.
        """
        super().__init__(backend, robot, {"seconds": seconds})

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the pace with a longer head start; each episode draws its own from a range."""
        seconds = self.ranges["seconds"]
        return replace(
            execution,
            head_start=execution.head_start + seconds.low,
            head_start_jitter=execution.head_start_jitter + seconds.high - seconds.low,
        )
