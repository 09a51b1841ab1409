"""The error of a base that finds itself in a map: drift, and the jumps that correct it."""

import numpy as np

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory, measured
from kinfeas.sim2real.adapters.draws import Number
from kinfeas.sim2real.vectors import displaced


class Localisation(Adapter):
    """Shows the base beside where it is, as a particle filter does.

    The odometry drifts, a random walk; now and then the filter corrects it, which is a jump to
    another error. An episode begins without one, for the map is where the base then thinks it is.
    What is commanded in the map's axes is carried out in axes that are turned by the error.
    """

    def __init__(  # noqa: PLR0913 - each is a key of the YAML
        self,
        backend: Backend,
        robot: Robot,
        *,
        drift: Number = 0.003,
        turn_drift: Number = 0.002,
        jump: Number = 0.015,
        turn_jump: Number = 0.01,
        rate: Number = 0.1,
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What measures.
            robot: Whom it moves.
            drift: Standard deviation in m that the walk along each axis has after a second.
            turn_drift: The same of the heading, rad.
            jump: Standard deviation of the error along each axis after a jump, m.
            turn_jump: The same of the heading, rad.
            rate: How often it jumps on average, 1/s.

        Raises:
            ValueError: If a number is negative or not finite.
        """
        numbers = {"drift": drift, "turn_drift": turn_drift, "jump": jump, "turn_jump": turn_jump}
        super().__init__(backend, robot, {**numbers, "rate": rate})

    def on_reset(self, state: RobotState) -> Memory:
        """Return an error (x, y, yaw) of nothing."""
        return {"error": np.zeros((len(state.base_pose), 3))}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist in the axes that the base takes for those of the map."""
        angle = self.memory["error"][:, 2]
        cosine, sine = np.cos(angle), np.sin(angle)
        turned = twist.copy()
        turned[:, 0] = cosine * twist[:, 0] + sine * twist[:, 1]
        turned[:, 1] = cosine * twist[:, 1] - sine * twist[:, 0]
        return turned, targets

    def on_step(self, state: RobotState, dt: float) -> None:
        """Drift for `dt` seconds, or jump."""
        noise = self.normal(6)
        walk = noise[:, :3] * self._each("drift") * np.sqrt(dt)
        joint_jumps = self.uniform(1) <= -np.expm1(-self.number("rate") * dt)
        error = np.where(
            joint_jumps, noise[:, 3:] * self._each("jump"), self.memory["error"] + walk
        )
        self.remember(error=error)

    def modify_state(self, state: RobotState) -> RobotState:
        """Return the state with the base beside where it is."""
        error = np.zeros((len(state.base_pose), 6))
        error[:, [0, 1, 5]] = self.memory["error"]
        return measured(state, base_pose=displaced(state.base_pose, error))

    def _each(self, name: str) -> Array:
        """Return a deviation for x, y and yaw, shape (n, 3)."""
        metres, radians = self.number(name), self.number(f"turn_{name}")
        return np.concatenate([metres, metres, radians], axis=1)
