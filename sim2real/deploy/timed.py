"""A simulated world that keeps to the clock on the wall."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.sim2real.deploy.passing import Passing
from kinfeas.sim2real.deploy.rate import Rate


class Timed(Passing):
    """A backend whose control periods take as long as they say."""

    def __init__(self, backend: Backend, rate: Rate) -> None:
        """Wrap a backend that has no clock of its own."""
        super().__init__(backend)
        self.rate = rate

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Pass on and start the clock; shapes as in `Backend`."""
        state = self.backend.reset(base_pose, joint_positions, env_ids)
        self.rate.wait()
        return state

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Pass on and wait for the end of the control period; shapes as in `Backend`."""
        state = self.backend.step(base_twist, joint_targets, dt)
        self.rate.wait()
        return state

    def close(self) -> None:
        """Close the wrapped backend."""
        self.backend.close()
