"""Noise on the measured joint positions."""

from kinfeas.core.backend import Backend, RobotState
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, measured
from kinfeas.sim2real.adapters.draws import Number


class JointNoise(Adapter):
    """Shows the arm's joints with Gaussian noise, anew in each reading."""

    def __init__(self, backend: Backend, robot: Robot, *, deviation: Number = 0.002) -> None:
        """Wrap a backend.

        Args:
            backend: What measures.
            robot: Whom it moves.
            deviation: Standard deviation, rad of turning and m of sliding joints.

        Raises:
            ValueError: If it is negative or not finite.
        """
        super().__init__(backend, robot, {"deviation": deviation})

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state with noise on the joint positions."""
        noise = self.normal(state.joint_positions.shape[1]) * self.number("deviation")
        return measured(state, joint_positions=self.joints(state.joint_positions + noise))
