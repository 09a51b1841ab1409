"""The obstacle filter: base commands that keep a distance from obstacles."""

from typing import Annotated

import numpy as np
from annotated_types import Interval

from kinfeas.control.filters.half_spaces import LEVER, VelocityConstraints, allowed, approach
from kinfeas.control.period import Period
from kinfeas.core.backend import Backend, ObstacleDistances, ObstacleSensor
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.kinematics.drive import command_size
from kinfeas.kinematics.ik import IkSolver
from kinfeas.robots.robot import Base

MIN_DISTANCE = 0.03  # distance that bases keep from obstacles by default, metres
_RIM = 0.5  # radius in metres at which a turning base is assumed to have its rim


class VelocityDamper:
    """Velocity constraints that let bases brake before they reach obstacles.

    Faverjon and Tournassoud, "A local based approach for path planning of manipulators with a high
    number of degrees of freedom", 1987.

    Args:
        base: Drive and limits of the bases.
        dt: Control period, seconds.
        min_distance: Distance that bases keep from obstacles, metres.
    """

    def __init__(self, base: Base, dt: float, min_distance: float = MIN_DISTANCE) -> None:
        translations = [base.max_velocity] * (command_size(base) - 1)
        self._full = np.array([*translations, base.max_rotation * LEVER])
        fastest = base.max_velocity + base.max_rotation * _RIM
        braking = min(base.max_acceleration, base.max_rotation_acceleration * _RIM)
        # Obstacles further away do not limit the base.
        self._range = min_distance + max(fastest**2 / braking, 2.0 * dt * fastest)
        self._rules = np.array([min_distance, braking, 2.0 * dt])

    def constraints(self, sensor: ObstacleSensor, n: int) -> VelocityConstraints:
        """Return the velocity constraints of n bases now.

        Half of the braking that the base is capable of suffices, and a control period uses at most
        half of the remaining distance.
        """
        near = sensor.obstacle_distances(self._range)
        if not isinstance(near, ObstacleDistances) or len(near.distance) != n:
            raise KinfeasError(f"the backend must return ObstacleDistances of {n} robots")
        k, full = near.distance.shape[1], self._full
        normal, limit = np.empty((n, k + 2, len(full))), np.empty((n, k + 2))
        closing = np.zeros(k) if near.closing_speed is None else near.closing_speed
        approach(near.closest_point, near.normal, full, out=normal[:, :k])
        allowed(near.distance, closing, self._rules, out=limit[:, :k])
        # The rotation limit is a constraint as well, so that a projection does not exceed it.
        normal[:, k:], limit[:, k:] = 0.0, full[-1]
        normal[:, k:, -1] = 1.0, -1.0
        return VelocityConstraints(full, normal, limit)


class ObstacleFilter:
    """Limits the velocity towards near obstacles, so that the base can brake in time.

    The base restores a distance that is too small and, where the backend measures closing speeds,
    gives way to obstacles that move towards it. The backend must measure distances to obstacles.

    Args:
        solver: IK of the robot.
        backend: Measures the distances.
        dt: Control period, seconds.
        min_distance: Distance that the base keeps from obstacles, metres.
    """

    def __init__(
        self,
        solver: IkSolver,
        backend: Backend,
        dt: float,
        min_distance: Annotated[float, Interval(ge=0.0, le=10.0)] = MIN_DISTANCE,
    ) -> None:
        if backend.obstacles is None:
            raise KinfeasError(
                "the filter obstacle_distance needs a backend that measures distances to "
                f"obstacles; {backend.name} does not"
            )
        self._sensor, self._note = backend.obstacles, plugin_note(f"backend {backend.name}")
        self._damper = VelocityDamper(solver.robot.base, dt, min_distance)

    def __call__(self, period: Period) -> Period:
        """Return the period with commands that keep the distance."""
        with self._note:
            constraints = self._damper.constraints(self._sensor, len(period.command))
        command = constraints.hold(period.command[:, np.newaxis])[:, 0]
        return period.changed(command=command, velocity_constraints=constraints)
