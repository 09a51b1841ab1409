"""Noise on the base velocity, as training and deployment studies use it."""

from kinfeas.core.backend import Backend
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter
from kinfeas.sim2real.adapters.draws import Number


class BaseNoise(Adapter):
    """Adds Gaussian noise to the base's planar velocity and to its turning.

    A base that stands still and is commanded to do so is disturbed as well.
    """

    stream = ""  # as it was before there were others

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        linear: Number = 0.015,
        angular: Number = 0.015,
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the disturbed commands.
            robot: Whom it moves.
            linear: Standard deviation of the velocity along each planar axis, m/s.
            angular: Standard deviation of the turning rate, rad/s.

        Raises:
            ValueError: If a deviation is negative or not finite.
        """
        super().__init__(backend, robot, {"linear": linear, "angular": angular})

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, disturbed, and the joint targets."""
        noise = self.normal(3)
        disturbed = twist.copy()
        disturbed[:, :2] += noise[:, :2] * self.number("linear")
        disturbed[:, 5:] += noise[:, 2:] * self.number("angular")
        return disturbed, targets
