"""Joint targets kept within the arm's limits."""

import numpy as np

from kinfeas.core.backend import Backend
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.adapters.draws import Number


class JointLimitClamp(Adapter):
    """Moves joint targets that are beyond the soft limits, or too near to them, back to there."""

    def __init__(self, backend: Backend, robot: Robot, *, margin: Number = 0.0) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the commands within the limits.
            robot: Whom it moves.
            margin: Distance kept from the limits, rad or m; at most half of a joint's range.

        Raises:
            ValueError: If it is negative, not finite or leaves nothing of a joint's range.
        """
        super().__init__(backend, robot, {"margin": margin})
        self._lower, self._upper = robot.joint_limits
        half = float((self._upper - self._lower).min()) / 2.0
        if self.ranges["margin"].high > half:
            raise ValueError(f"margin is {margin}, at most {half:.4g} is half a joint's range")

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, and the joint targets within the limits."""
        margin = self.number("margin")
        return twist, np.clip(targets, self._lower + margin, self._upper - margin)
