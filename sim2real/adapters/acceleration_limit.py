"""A base with inertia: its velocity changes no faster than its accelerations allow."""

import numpy as np

from kinfeas.config import Interval
from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.adapters.adapter import Adapter, Memory
from kinfeas.sim2real.adapters.draws import Number
from kinfeas.sim2real.vectors import length, shortened


class AccelerationLimit(Adapter):
    """Limits the acceleration of the base, and its jerk if one is given.

    In the plane the limits hold for the length of the vector, whatever its direction. With a jerk
    limit the acceleration fades in time, so that the commanded velocity is met rather than passed.
    """

    def __init__(
        self,
        backend: Backend,
        robot: Robot,
        *,
        linear: Number | None = None,
        angular: Number | None = None,
        linear_jerk: Number | None = None,
        angular_jerk: Number | None = None,
    ) -> None:
        """Wrap a backend.

        Args:
            backend: What carries out the commands within the limits.
            robot: Whom it moves.
            linear: Largest acceleration in the plane, m/s^2; the robot's own by default.
            angular: Largest angular acceleration, rad/s^2; the robot's own by default.
            linear_jerk: Largest change of the acceleration, m/s^3; none by default.
            angular_jerk: The same for the rotation, rad/s^3; none by default.

        Raises:
            ValueError: If a limit is not above 0 and finite.
        """
        base = robot.base
        limits = {
            "linear": base.max_acceleration if linear is None else linear,
            "angular": base.max_rotation_acceleration if angular is None else angular,
            "linear_jerk": linear_jerk,
            "angular_jerk": angular_jerk,
        }
        given = {name: value for name, value in limits.items() if value is not None}
        super().__init__(backend, robot, given, Interval(low=0.0, open_low=True))

    def on_reset(self, state: RobotState) -> Memory:
        """Return a base at rest."""
        rest = np.zeros((len(state.base_pose), 6))
        return {"velocity": rest, "acceleration": rest}

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the velocity that the base can have at the end of the period."""
        velocity, acceleration = self.memory["velocity"], self.memory["acceleration"].copy()
        wanted = (twist - velocity) / dt
        for part, name in ((slice(0, 3), "linear"), (slice(3, 6), "angular")):
            acceleration[:, part] = self._limited(wanted[:, part], acceleration[:, part], name, dt)
        # Where nothing is limited, rounding must not change the command either.
        reached = np.where(acceleration == wanted, twist, velocity + acceleration * dt)
        self.remember(velocity=reached, acceleration=acceleration)
        return reached, targets

    def _limited(self, wanted: Array, before: Array, name: str, dt: float) -> Array:
        """Return the acceleration nearest to the wanted one, shape (n, 3)."""
        largest = self.number(name)
        if f"{name}_jerk" not in self.ranges:
            return shortened(wanted, largest)
        jerk = self.number(f"{name}_jerk")
        # From an acceleration a the jerk needs the velocity a^2 / (2 jerk) to come to rest.
        fading = np.sqrt(2.0 * jerk * length(wanted) * dt)
        change = shortened(wanted, np.minimum(largest, fading)) - before
        full = length(change) <= jerk * dt
        reached = before + np.where(full, change, shortened(change, jerk * dt))
        return shortened(reached, largest)
