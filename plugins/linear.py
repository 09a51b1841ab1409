"""The `linear` motion: straight to the goal, slowing down near it."""

from dataclasses import dataclass

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rngs, State, TwistAndState
from kinfeas.core.quantities import Positive
from kinfeas.core.spatial import Array, twist_between
from kinfeas.plugins.path import norm

# Below this distance in metres a motion is a rotation on the spot, with a speed set by its angle.
_ON_THE_SPOT = 1e-6
_MIN_ANGULAR_VELOCITY = 0.001  # rad/s, so that a rotation on the spot ends
_TINY = 1e-12  # keeps quotients finite; in metres and in radians


@dataclass(eq=False, kw_only=True)
class Linear:
    """Straight motion of the EE to the target: a linear dynamic system in position and orientation.

    The speed is `clip(gain * distance, min_velocity, max_velocity)`. Position and orientation cover
    equal fractions of the rest of the motion, so along the straight line the orientation is the
    slerp from the start to the goal by the fraction of the distance covered; they arrive together.
    Where the rotation would exceed its limit, the whole motion slows down. The twist depends on the
    EE pose and the goal alone, so a displaced EE heads straight for the goal.

    Args:
        gain: Speed per distance to the goal, 1/s; on the spot, angular speed per angle.
        min_velocity: Lower limit of the speed in m/s, so that the motion arrives; the angular
            limit takes precedence.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s; None for no limit.
    """

    gain: Positive = 0.1
    min_velocity: Positive = 0.001
    max_velocity: Positive = 0.1
    max_angular_velocity: Positive | None = 0.1

    def __post_init__(self) -> None:
        """Raise KinfeasError unless the limits of the speed ascend."""
        low, high = self.min_velocity, self.max_velocity
        if low > high:
            raise KinfeasError(f"min_velocity must be at most max_velocity, {high}, not {low}")

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return an empty state: the motion depends on the current poses alone."""
        return {}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the targets, shape (n, 7)."""
        return np.array(target_pose, dtype=np.float64)

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        displacement = twist_between(ee_pose, target_pose, 1.0)
        metres = np.maximum(norm(displacement[:, :3]), _TINY)
        radians = np.maximum(norm(displacement[:, 3:]), _TINY)
        slowest = np.where(
            metres > _ON_THE_SPOT, self.min_velocity / metres, _MIN_ANGULAR_VELOCITY / radians
        )
        rate = np.minimum(np.maximum(self.gain, slowest), self.max_velocity / metres)
        rate = np.minimum(rate, (self.max_angular_velocity or np.inf) / radians)
        # Never past the goal: at most the whole displacement within dt.
        return displacement * np.minimum(rate, 1.0 / dt)[:, np.newaxis], dict(state)
