"""A head start: the base moves before the EE does."""

from dataclasses import replace

from kinfeas.backend import Backend
from kinfeas.legs import Pace
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapter import Adapter
from kinfeas.sim2real.draws import Number


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

    def pace(self, pace: Pace) -> Pace:
        """Return the pace with a longer head start; each episode draws its own from a range."""
        seconds = self.ranges["seconds"]
        return replace(
            pace,
            head_start=pace.head_start + seconds.low,
            spread=pace.spread + seconds.high - seconds.low,
        )
