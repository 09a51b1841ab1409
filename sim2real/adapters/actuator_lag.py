"""Actuators that follow their commands with a lag of first order."""

import numpy as np

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory
from kinfeas.sim2real.adapters.draws import Number


class ActuatorLag(Adapter):
    """Lets the base's velocity and the arm's positions approach what is commanded exponentially.

    After a command has held for one time constant, 63 % of the way are done. The base moves by the
    mean of its velocity in a control period, so that it comes to the same place at any rate.
    """

    def __init__(
        self, backend: Backend, robot: Robot, *, base: Number = 0.1, arm: Number = 0.02
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the lagging commands.
            robot: Whom it moves.
            base: Time constant of the base's velocity, s.
            arm: Time constant of the joint positions, s.

        Raises:
            ValueError: If a time is negative or not finite.
        """
        super().__init__(backend, robot, {"base": base, "arm": arm})

    def on_reset(self, state: RobotState) -> Memory:
        """Return a robot at rest."""
        joints = state.joint_positions
        return {"velocity": np.zeros((len(joints), 6)), "joints": joints}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the mean velocity, and the joint positions at the end of the period."""
        base, left = self._left("base", dt)
        behind = self.memory["velocity"] - twist
        mean = twist + behind * (base * (1.0 - left) / dt)
        _, remaining = self._left("arm", dt)
        way = self.turned(targets, self.memory["joints"])
        joints = self.joints(targets + way * remaining)
        self.remember(velocity=twist + behind * left, joints=joints)
        return mean, joints

    def _left(self, name: str, dt: float) -> tuple[Array, Array]:
        """Return a time constant, and the share of the way left after `dt`, each (n, 1)."""
        time = self.number(name)
        # Without a lag nothing is left.
        return time, np.exp(-dt / np.where(time > 0.0, time, 1.0)) * (time > 0.0)
