"""Noise on the EE pose as it is measured in the base frame."""

from kinfeas.core.backend import Backend, RobotState
from kinfeas.kinematics.forward import build_chain, forward
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, measured
from kinfeas.sim2real.adapters.draws import Number
from kinfeas.sim2real.vectors import displaced


class EeNoise(Adapter):
    """Shows the EE beside where the joints have it, by Gaussian noise, anew in each reading.

    As if a camera looked at the hand. The joints are shown as they are.
    """

    def __init__(
        self, backend: Backend, robot: Robot, *, linear: Number = 0.003, angular: Number = 0.005
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What measures.
            robot: Whom it moves.
            linear: Standard deviation of the position along each axis, m.
            angular: Standard deviation of the orientation about each axis, rad.

        Raises:
            ValueError: If a deviation is negative or not finite.
        """
        super().__init__(backend, robot, {"linear": linear, "angular": angular})
        self._chain = build_chain(robot)

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state with an EE pose that has noise."""
        exact = state.ee_in_base
        if exact is None:
            exact = forward(self._chain, state.joint_positions)
        noise = self.normal(6)
        noise[:, :3] *= self.number("linear")
        noise[:, 3:] *= self.number("angular")
        return measured(state, ee_in_base=displaced(exact, noise))
