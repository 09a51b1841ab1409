"""The `minimum_jerk` motion: point to point with least jerk."""

from dataclasses import dataclass

import numpy as np

from kinfeas.core.motion import Rngs, State, TwistAndState
from kinfeas.core.quantities import Positive
from kinfeas.core.spatial import Array, integrate, twist_between
from kinfeas.plugins.path import norm, slowed

_PEAK = 1.875  # greatest slope of the profile, in the middle


@dataclass(eq=False, kw_only=True)
class MinimumJerk:
    """Straight motion to the target, from rest to rest, as fast as the limits allow.

    Position and orientation cover the same fraction `10 s^3 - 15 s^4 + 6 s^5`, with `s` the
    fraction of the time: the motion of least squared jerk (Flash and Hogan, J. Neuroscience 5(7),
    1985, equation 2). The duration is the shortest in which neither limit is exceeded. A displaced
    EE comes back to the line while the motion's time slows down; the line ends at the current
    target.

    Args:
        min_duration: Shortest duration of a motion in seconds.
        max_velocity: Upper limit of the speed in m/s, reached halfway.
        max_angular_velocity: Upper limit of the angular speed in rad/s, likewise.
    """

    min_duration: Positive = 1.0
    max_velocity: Positive = 0.1
    max_angular_velocity: Positive = 0.1

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return start poses, shape (n, 7), durations and times in seconds, both (n,)."""
        begin = np.array(ee_pose, dtype=np.float64)
        displacement = twist_between(begin, target_pose, 1.0)
        linear = _PEAK * norm(displacement[:, :3]) / self.max_velocity
        angular = _PEAK * norm(displacement[:, 3:]) / self.max_angular_velocity
        duration = np.maximum(np.maximum(linear, angular), self.min_duration)
        return {"start_pose": begin, "duration": duration, "time": np.zeros(len(begin))}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the targets, shape (n, 7)."""
        return np.array(target_pose, dtype=np.float64)

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        time = np.minimum(state["time"] + dt, state["duration"])
        twist = twist_between(ee_pose, self._at(state, target_pose, time), dt)
        scale = slowed(twist, self.max_velocity, self.max_angular_velocity)
        passed = state["time"] + scale * (time - state["time"])
        return twist * scale[:, np.newaxis], {**state, "time": passed}

    def _at(self, state: State, target_pose: Array, time: Array) -> Array:
        """Return the desired poses at times of the motions, (n,) -> (n, 7)."""
        displacement = twist_between(state["start_pose"], target_pose, 1.0)
        s = (time / state["duration"])[:, np.newaxis]
        covered = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return integrate(state["start_pose"], displacement * covered, 1.0)
