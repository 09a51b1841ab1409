"""Domain randomisation: other masses, frictions and motors in each episode."""

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.control.adapters import chain
from kinfeas.core.backend import Backend, RobotState, SupportsDynamics
from kinfeas.core.errors import KinfeasError
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

    def check_backend(self) -> None:
        """Check that the world has physics."""
        self._physics()

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Reset the backend and change the dynamics of the new episodes."""
        physics = self._physics()
        state = super().reset(base_pose, joint_positions, env_ids)
        rows = np.arange(len(base_pose)) if env_ids is None else env_ids
        mass, friction, motor_gain = (self.number(one)[rows, 0] for one in self.ranges)
        physics.scale_dynamics(mass, friction, motor_gain, rows)
        return state

    def _physics(self) -> SupportsDynamics:
        *_, innermost = chain(self.backend)
        if not isinstance(innermost, SupportsDynamics):
            raise KinfeasError(
                "the adapter domain_randomisation needs a world with physics; "
                f"{type(innermost).__name__} has none"
            )
        return innermost
