"""The obstacle filter: base commands that keep a distance from obstacles."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from kinfeas.control.adapters import chain
from kinfeas.control.drive import carried_out, command_size
from kinfeas.control.filters.half_spaces import project
from kinfeas.control.loop import Loop
from kinfeas.core.backend import ObstacleDistances, SupportsObstacleDistances
from kinfeas.core.errors import KinfeasError, plugin_note
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Base

_RIM = 0.5
"""Radius in metres at which a turning base is assumed to have its rim."""

_LEVER = 0.05
"""Radius in metres by which rotations are compared with translations. It is small, so that a base
turns aside before it leaves the path of its arm."""

_RESTORE = 0.5
"""Seconds in which a base restores most of a distance that is too small."""

_SLACK = 1e-6
"""Velocity in m/s by which rounding may exceed a constraint."""


@dataclass(frozen=True)
class VelocityConstraints:
    """Linear constraints on base velocities u of n robots: `normal @ u <= limit`.

    Attributes:
        full: Velocity of a full command in each direction, shape (a,), m/s; rotation at `_LEVER`.
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
        velocity = carried_out(action) * self.full
        breach = project(velocity, self.normal, self.limit, _SLACK)
        held = velocity / self.full
        # A detour that is faster than the base can drive slows the whole command down.
        speed = np.linalg.norm(held[..., :-1], axis=-1, keepdims=True)
        return np.where(breach[..., np.newaxis], held / np.maximum(speed, 1.0), action)


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
        *_, self._innermost = chain(loop.backend)
        if not isinstance(loop.backend, SupportsObstacleDistances):
            raise KinfeasError(
                "the filter obstacle_distance needs a backend that measures distances to "
                f"obstacles; {type(self._innermost).__name__} does not"
            )
        self._measure = loop.backend.obstacle_distances
        self._full = _full_velocity(base)
        fastest = base.max_velocity + base.max_rotation * _RIM
        self._braking = min(base.max_acceleration, base.max_rotation_acceleration * _RIM)
        # Obstacles further away do not limit the base.
        way = max(fastest**2 / self._braking, 2.0 * loop.dt * fastest)
        self._range = self.min_distance + way

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
        name = f"backend {type(self._innermost).__name__}"
        with plugin_note(name):
            found = self._measure(self._range)
        if not isinstance(found, ObstacleDistances) or len(found.distance) != n:
            raise KinfeasError(f"{name} must return ObstacleDistances of {n} robots")
        way = found.distance - self.min_distance
        ahead = np.maximum(way, 0.0)
        limit = np.minimum(np.sqrt(self._braking * ahead), ahead / (2.0 * self._loop.dt))
        # A turn leads a little off the straight way, so the base restores the distance.
        limit += np.minimum(way, 0.0) / _RESTORE
        if found.closing_speed is not None:
            # Receding obstacles may turn back.
            limit -= np.maximum(found.closing_speed, 0.0)
        normal = _approach(found, len(self._full))
        # The rotation limit is a constraint as well, so that a projection does not exceed it.
        turns = np.zeros((n, 2, len(self._full)))
        turns[:, :, -1] = [1.0, -1.0]
        fastest = np.full((n, 2), self._full[-1])
        return VelocityConstraints(
            self._full,
            np.concatenate([normal, turns], axis=1),
            np.concatenate([limit, fastest], axis=1),
        )


def _full_velocity(base: Base) -> Array:
    """Return the velocities of a full command, shape (a,), m/s."""
    translations = command_size(base) - 1
    return np.array([*[base.max_velocity] * translations, base.max_rotation * _LEVER])


def _approach(found: ObstacleDistances, size: int) -> Array:
    """Return the share of each of `size` velocities that approaches each obstacle, (n, k, size)."""
    turn = (
        found.normal[..., 1] * found.closest_point[..., 0]
        - found.normal[..., 0] * found.closest_point[..., 1]
    )
    translations = found.normal[..., : size - 1]
    return np.concatenate([translations, turn[..., np.newaxis] / _LEVER], axis=-1)
