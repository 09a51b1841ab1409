"""The `linear` motion: straight to the goal, slowing down as it comes near."""

from collections.abc import Sequence

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import State
from kinfeas.core.spatial import Array, twist_between
from kinfeas.plugins.limits import norm, positive

# Below this distance a motion is a turn on the spot, and the angle sets its pace, in metres.
_ON_THE_SPOT = 1e-6
_MIN_ANGULAR_VELOCITY = 0.001  # rad/s, so that a turn on the spot ends
_TINY = 1e-12  # keeps quotients finite; in metres and in radians


class Linear:
    """Straight motion of the EE to the target: a linear dynamic system in position and orientation.

    The speed is `clip(gain * distance, min_velocity, max_velocity)`. Position and orientation use
    up equal shares of what is left of them, so along the straight line the orientation is the
    slerp from the start to the goal by the fraction of the distance covered; and they arrive
    together. Where the turn would exceed its limit, the whole motion slows down. What comes next
    depends on the EE pose and the goal alone, so an EE that was displaced heads straight for the
    goal from wherever it is.

    Args:
        gain: Speed per distance to the goal, 1/s; in a turn on the spot, angular speed per angle.
        min_velocity: Lower limit of the speed in m/s, so that the motion arrives; the angular
            limit goes first.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s; None lifts it.

    Raises:
        KinfeasError: If a number is not positive, or the velocity limits are out of order.
    """

    def __init__(
        self,
        *,
        gain: float = 0.1,
        min_velocity: float = 0.001,
        max_velocity: float = 0.1,
        max_angular_velocity: float | None = 0.1,
    ) -> None:
        self._gain = positive("gain", gain)
        self._min_velocity = positive("min_velocity", min_velocity)
        self._max_velocity = positive("max_velocity", max_velocity)
        self._max_angular_velocity = (
            None
            if max_angular_velocity is None
            else positive("max_angular_velocity", max_angular_velocity)
        )
        if min_velocity > max_velocity:
            raise KinfeasError(
                f"min_velocity must be at most max_velocity, {max_velocity}, not {min_velocity}"
            )

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions, which is empty: the way is that to the target."""
        return {}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return np.array(target_pose, dtype=np.float64)

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array
    ) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: World pose that the motion has come to, shape (n, 7).
            target_pose: World pose of the target now, shape (n, 7).
            dt: Duration of each motion's step in seconds, shape (n,).
        """
        way = twist_between(ee_pose, target_pose, 1.0)
        # Never past the goal: at most the whole way within dt.
        execution = np.minimum(self._pace(way), 1.0 / dt)
        return way * execution[:, np.newaxis], dict(state)

    def _pace(self, way: Array) -> Array:
        """Return the share of the remaining `way`, shape (n, 6), to use up per second, (n,)."""
        metres = np.maximum(norm(way[:, :3]), _TINY)
        radians = np.maximum(norm(way[:, 3:]), _TINY)
        slowest = np.where(
            metres > _ON_THE_SPOT, self._min_velocity / metres, _MIN_ANGULAR_VELOCITY / radians
        )
        execution = np.minimum(np.maximum(self._gain, slowest), self._max_velocity / metres)
        if self._max_angular_velocity is None:
            return execution
        return np.minimum(execution, self._max_angular_velocity / radians)
