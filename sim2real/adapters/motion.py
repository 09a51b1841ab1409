"""Changes of the execution of EE motions: head start and time scale."""

from dataclasses import replace

from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.backend import Backend
from kinfeas.core.quantities import TIME_SCALES
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Number


class HeadStart(Adapter):
    """EE motions that start after the base does.

    Args:
        seconds: Time in seconds for which the EE is at rest; added to other head starts.
    """

    def __init__(self, backend: Backend, robot: Robot, *, seconds: Number = 3.0) -> None:
        super().__init__(backend, robot, {"seconds": seconds})

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the execution with a longer head start, drawn for each episode from a range."""
        (low, high), within = self.ranges["seconds"], super().execution(execution)
        jitter = within.head_start_jitter + high - low
        return replace(within, head_start=within.head_start + low, head_start_jitter=jitter)


class TimeScale(Adapter):
    """Slower EE motions than planned; dwells keep their time.

    Args:
        factor: Fraction of the planned speed, 0.001 to 1; multiplied with others. All episodes of a
            batch have the same time scale, so a range raises an error.
    """

    def __init__(self, backend: Backend, robot: Robot, *, factor: Number = 0.5) -> None:
        super().__init__(backend, robot, {"factor": factor}, TIME_SCALES)
        if self.ranges["factor"].low < self.ranges["factor"].high:
            raise ValueError(f"factor is {factor!r}, must be one number for all episodes")

    def execution(self, execution: ExecutionConfig) -> ExecutionConfig:
        """Return the slower execution."""
        within = super().execution(execution)
        return replace(within, time_scale=within.time_scale * self.ranges["factor"].low)
