"""Commands that get lost."""

import numpy as np

from kinfeas.config import Interval
from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory
from kinfeas.sim2real.adapters.draws import Number


class DroppedCommands(Adapter):
    """Loses commands, each for itself; meanwhile the robot goes on with the last that came."""

    def __init__(self, backend: Backend, robot: Robot, *, share: Number = 0.05) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the commands that come.
            robot: Whom it moves.
            share: Of the commands that get lost, 0-1.

        Raises:
            ValueError: If it is no share.
        """
        super().__init__(backend, robot, {"share": share}, Interval(0.0, 1.0))

    def on_reset(self, state: RobotState) -> Memory:
        """Return the command to stand still."""
        joints = state.joint_positions
        return {"twist": np.zeros((len(joints), 6)), "targets": joints}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the command, or the last one that came."""
        lost = self.uniform(1) <= self.number("share")
        twist = np.where(lost, self.memory["twist"], twist)
        targets = np.where(lost, self.memory["targets"], targets)
        self.remember(twist=twist, targets=targets)
        return twist, targets
