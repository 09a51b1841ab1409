"""Commands kept within the velocities of base and arm."""

import numpy as np

from kinfeas.config import Interval
from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory
from kinfeas.sim2real.adapters.draws import Number
from kinfeas.sim2real.vectors import shortened


class VelocityClamp(Adapter):
    """Shortens commands that are faster than base or arm may move.

    A joint that is sent too far goes on toward its target in the periods that follow.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        linear: Number | None = None,
        angular: Number | None = None,
        joints: Number = 1.0,
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the commands within the limits.
            robot: Whom it moves.
            linear: Largest velocity of the base, m/s; the robot's own by default.
            angular: Largest turning rate, rad/s; the robot's own by default.
            joints: Share of each joint's largest velocity, above 0.

        Raises:
            ValueError: If a number is not above 0 and finite.
        """
        limits = {
            "linear": robot.base.max_velocity if linear is None else linear,
            "angular": robot.base.max_rotation if angular is None else angular,
            "joints": joints,
        }
        super().__init__(backend, robot, limits, Interval(low=0.0, open_low=True))

    def on_reset(self, state: RobotState) -> Memory:
        """Return where the arm is."""
        return {"joints": state.joint_positions}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the command within the limits."""
        clamped = twist.copy()
        clamped[:, :3] = shortened(twist[:, :3], self.number("linear"))
        clamped[:, 3:] = shortened(twist[:, 3:], self.number("angular"))
        before = self.memory["joints"]
        way = self.turned(before, targets)
        longest = self.robot.max_joint_velocity * self.number("joints") * dt
        short = self.joints(before + np.clip(way, -longest, longest))
        joints = np.where(np.abs(way) <= longest, targets, short)
        self.remember(joints=joints)
        return clamped, joints
