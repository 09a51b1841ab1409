"""The obstacle filter: base commands that keep a distance from obstacles."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.control.adapters import chain
from kinfeas.control.filters.half_spaces import LEVER, allowed, approach, hold
from kinfeas.control.loop import Loop
from kinfeas.core.backend import ObstacleDistances, SupportsObstacleDistances
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array
from kinfeas.kinematics.drive import command_size
from kinfeas.robots.robot import Base

_RIM = 0.5
"""Radius in metres at which a turning base is assumed to have its rim."""


@dataclass(frozen=True)
class VelocityConstraints:
    """Linear constraints on base velocities u of n robots: `normal @ u <= limit`.

    Attributes:
        full: Velocity of a full command in each direction, shape (a,), m/s; rotation at `LEVER`.
        normal: Share of each velocity that approaches each of k obstacles, shape (n, k, a).
        limit: Allowed approach velocities, shape (n, k), m/s; inf without obstacle, negative where
            the base must move away.
    """

    full: Array
    normal: Array
    limit: Array

    def of(self, rows: NDArray[np.intp]) -> "VelocityConstraints":
        """Return the constraints of some rows."""
        return VelocityConstraints(self.full, self.normal[rows], self.limit[rows])

    def hold(self, action: Array) -> Array:
        """Return the commands nearest to `action` that satisfy the constraints.

        Commands that satisfy them stay bit-identical. No row depends on the others.

        Args:
            action: Base commands, shape (n, t, a): t for each row.
        """
        held = np.array(action, dtype=np.float64, order="C")
        hold(held, self.full, self.normal, self.limit)
        return held


class ObstacleFilter:
    """Limits the velocity towards near obstacles, so that the base can brake in time.

    The base restores a distance that is too small and, where the backend measures closing speeds,
    gives way to obstacles that move towards it.

    A velocity damper (Faverjon and Tournassoud, "A local based approach for path planning of
    manipulators with a high number of degrees of freedom", 1987). The backend must measure
    distances to obstacles.

    Args:
        min_distance: Distance that the base keeps from obstacles, metres.
    """

    def __init__(self, min_distance: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.03) -> None:
        self.min_distance = min_distance

    def reset(self, loop: Loop, rows: NDArray[np.intp]) -> None:
        """Use the backend and the base of a loop; arguments as in `CommandFilter`."""
        self._loop, base = loop, loop.robot.base
        *_, innermost = chain(loop.backend)
        name = type(innermost).__name__
        if not isinstance(loop.backend, SupportsObstacleDistances):
            raise KinfeasError(
                "the filter obstacle_distance needs a backend that measures distances to "
                f"obstacles; {name} does not"
            )
        self._measure = loop.backend.obstacle_distances
        self._note = plugin_note(f"backend {name}")
        self._full = _full_velocity(base)
        fastest = base.max_velocity + base.max_rotation * _RIM
        braking = min(base.max_acceleration, base.max_rotation_acceleration * _RIM)
        # Obstacles further away do not limit the base.
        way = max(fastest**2 / braking, 2.0 * loop.dt * fastest)
        self._range = self.min_distance + way
        self._rules = np.array([self.min_distance, braking, 2.0 * loop.dt])

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return commands that keep the distance; arguments as in `CommandFilter`."""
        constraints = self.constraints(len(command))
        self._loop.period.velocity_constraints = constraints
        return constraints.hold(command[:, np.newaxis])[:, 0]

    def constraints(self, n: int) -> VelocityConstraints:
        """Return the velocity constraints of n bases now.

        Half of the braking that the base is capable of suffices, and a control period uses at most
        half of the remaining distance.
        """
        with self._note:
            found = self._measure(self._range)
        if not isinstance(found, ObstacleDistances) or len(found.distance) != n:
            raise KinfeasError(f"{self._note.plugin} must return ObstacleDistances of {n} robots")
        k, full = found.distance.shape[1], self._full
        normal, limit = np.empty((n, k + 2, len(full))), np.empty((n, k + 2))
        closing = np.zeros(k) if found.closing_speed is None else found.closing_speed
        approach(found.closest_point, found.normal, full, out=normal[:, :k])
        allowed(found.distance, closing, self._rules, out=limit[:, :k])
        # The rotation limit is a constraint as well, so that a projection does not exceed it.
        normal[:, k:], limit[:, k:] = 0.0, full[-1]
        normal[:, k:, -1] = 1.0, -1.0
        return VelocityConstraints(full, normal, limit)


def _full_velocity(base: Base) -> Array:
    """Return the velocities of a full command, shape (a,), m/s."""
    translations = command_size(base) - 1
    return np.array([*[base.max_velocity] * translations, base.max_rotation * LEVER])
