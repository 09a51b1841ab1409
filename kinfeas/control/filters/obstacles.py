"""The obstacle filter: base commands that keep a distance from obstacles."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.adapters import chain
from kinfeas.control.drive import action_size, carried_out
from kinfeas.control.filters.half_spaces import project
from kinfeas.core.backend import (
    Backend,
    ObstacleDistances,
    SupportsObstacleDistances,
    plugin_errors,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Base

_RIM = 0.5
"""How far from its middle a base is taken to reach, metres: so fast is its rim when it turns."""

_LEVER = 0.05
"""Metres from its middle at which turns are weighed against ways. It is little: a base with
something in its way had rather turn aside than leave the way on which it carries its arm."""

_NOTHING = 1e-6
"""A speed that is none, m/s: a breach by rounding."""


@dataclass(frozen=True)
class VelocityConstraints:
    """How bases may move: velocities u of a row, in m/s, keep `toward @ u <= most`.

    Attributes:
        full: Velocities of full commands, shape (a,), turns at `_LEVER` from the middle.
        normal: Share of each velocity that leads to each of k things, shape (n, k, a).
        most: How fast they may be approached, shape (n, k), at least 0; inf where nothing is.
    """

    full: Array
    normal: Array
    most: Array

    def of(self, rows: NDArray[np.intp]) -> "VelocityConstraints":
        """Return the limits of some rows."""
        return VelocityConstraints(self.full, self.normal[rows], self.most[rows])

    def hold(self, action: Array) -> Array:
        """Return the commands nearest to `action` that are within the limits.

        What is within them already stays as it is, to the bit. No row depends on the others.

        Args:
            action: Base commands, shape (n, t, a): t for each row.
        """
        velocity = carried_out(action) * self.full
        breach = project(velocity, self.normal, self.most, _NOTHING)
        held = velocity / self.full
        # Where the way round is faster than the base can be, all of the command slows down.
        speed = np.linalg.norm(held[..., :-1], axis=-1, keepdims=True)
        return np.where(breach[..., np.newaxis], held / np.maximum(speed, 1.0), action)


class ObstacleFilter:
    """Sees to it that no base comes nearer to what stands around than it should.

    Each thing near it lets the base approach so fast that it can still brake, as velocity dampers
    do (Faverjon and Tournassoud, "A local based approach for path planning of manipulators with a
    high number of degrees of freedom", 1987).

    Args:
        base: Drive and limits of the bases.
        backend: Knows what stands around.
        metres: How near bases may come.
        dt: Control period in seconds.

    Raises:
        KinfeasError: If the backend does not know what stands around.
    """

    def __init__(self, base: Base, backend: Backend, metres: float, dt: float) -> None:
        *_, self._innermost = chain(backend)
        if not isinstance(backend, SupportsObstacleDistances):
            raise KinfeasError(
                f"min_obstacle_distance={metres:g} needs a backend that measures distances to "
                f"obstacles, and "
                f"{type(self._innermost).__name__} does not: only 0 is allowed"
            )
        self._backend, self._metres, self._dt = backend, metres, dt
        self._full = _full_velocity(base)
        fastest = base.max_velocity + base.max_rotation * _RIM
        self._brakes = min(base.max_acceleration, base.max_rotation_acceleration * _RIM)
        # Whatever is further away may be approached as fast as the base can.
        self._look = metres + max(fastest**2 / self._brakes, 2.0 * dt * fastest)

    def limits(self, n: int) -> VelocityConstraints:
        """Return how fast n bases may approach what is near them now.

        So fast that half of the braking that the base is capable of suffices, and at most half of
        the way that is left in a control period.

        Raises:
            KinfeasError: If a backend from outside fails, or says nothing of the kind.
        """
        with plugin_errors(self._innermost, "obstacle_distances"):
            obstacle_distances: Any = self._backend.obstacle_distances(self._look)
        name = type(self._innermost).__name__
        if not isinstance(obstacle_distances, ObstacleDistances):
            got = type(obstacle_distances).__name__
            raise KinfeasError(
                f"backend {name} must return ObstacleDistances from obstacle_distances, not {got}"
            )
        if len(obstacle_distances.distance) != n:
            got = str(len(obstacle_distances.distance))
            raise KinfeasError(f"backend {name} must measure {n} robots, not {got}")
        way = np.maximum(obstacle_distances.distance - self._metres, 0.0)
        most = np.minimum(np.sqrt(self._brakes * way), way / (2.0 * self._dt))
        normal = _toward(obstacle_distances, len(self._full))
        # Nor does a base turn faster than it can: its way gives in then.
        turns = np.zeros((n, 2, len(self._full)))
        turns[:, :, -1] = [1.0, -1.0]
        fastest = np.full((n, 2), self._full[-1])
        return VelocityConstraints(
            self._full,
            np.concatenate([normal, turns], axis=1),
            np.concatenate([most, fastest], axis=1),
        )


def _full_velocity(base: Base) -> Array:
    """Return the velocities of a full command, shape (a,), m/s."""
    ways = action_size(base) - 1
    return np.array([*[base.max_velocity] * ways, base.max_rotation * _LEVER])


def _toward(obstacle_distances: ObstacleDistances, size: int) -> Array:
    """Return how much of each of `size` velocities leads to each thing, shape (n, k, size)."""
    turn = (
        obstacle_distances.normal[..., 1] * obstacle_distances.closest_point[..., 0]
        - obstacle_distances.normal[..., 0] * obstacle_distances.closest_point[..., 1]
    )
    ways = obstacle_distances.normal[..., : size - 1]
    return np.concatenate([ways, turn[..., np.newaxis] / _LEVER], axis=-1)
