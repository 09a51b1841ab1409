"""Domain randomisation: other masses, frictions and motors in each episode."""

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Number

_FACTORS = Interval(ge=0.1, le=10.0)


class DomainRandomisation(Adapter):
    """A robot whose dynamics differ from its model; for worlds with physics.

    Args:
        mass: Factor on the masses and inertias of the robot's links.
        friction: Factor on friction coefficients.
        motor_gain: Factor on the gains of the arm's motors, whose largest forces stay.
    """

    needs = "dynamics"

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        mass: Number = 1.0,
        friction: Number = 1.0,
        motor_gain: Number = 1.0,
    ) -> None:
        numbers = {"mass": mass, "friction": friction, "motor_gain": motor_gain}
        super().__init__(backend, robot, numbers, _FACTORS)

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Reset the backend and change the dynamics of the new episodes."""
        state = super().reset(base_pose, joint_positions, env_ids)
        rows = np.arange(len(base_pose)) if env_ids is None else env_ids
        mass, friction, motor_gain = (self.number(name)[rows, 0] for name in self.ranges)
        assert self.dynamics is not None
        self.dynamics.scale_dynamics(mass, friction, motor_gain, rows)
        return state
