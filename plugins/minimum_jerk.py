"""The `minimum_jerk` motion: point to point, as people reach."""

from collections.abc import Sequence

import numpy as np

from kinfeas.core.motion import State
from kinfeas.core.spatial import Array, integrate, twist_between
from kinfeas.plugins.limits import norm, positive, slowed

_PEAK = 1.875  # greatest slope of the profile, in the middle


class MinimumJerk:
    """Straight to the target in the time that the limits demand, from rest to rest.

    Position and orientation cover the same share `10 s^3 - 15 s^4 + 6 s^5` of their way, with `s`
    the share of the time: the motion of least squared jerk (Flash and Hogan, J. Neuroscience 5(7),
    1985, equation 2). The duration is the shortest in which neither limit is exceeded. An EE that
    was displaced comes back, and time waits for it; the way ends where the target is now.

    Args:
        min_duration: Shortest time in seconds that a motion takes.
        max_velocity: Upper limit of the speed in m/s, reached halfway.
        max_angular_velocity: Upper limit of the angular speed in rad/s, likewise.

    Raises:
        KinfeasError: If a number is not positive.
    """

    def __init__(
        self,
        *,
        min_duration: float = 1.0,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        self._min_duration = positive("min_duration", min_duration)
        self._max_velocity = positive("max_velocity", max_velocity)
        self._max_angular_velocity = positive("max_angular_velocity", max_angular_velocity)

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions: their starts, shape (n, 7), and times in seconds, (n,).

        Args:
            ee_pose: World pose of the driven frame, shape (n, 7).
            target_pose: World pose where the EE is to end, shape (n, 7).
            rngs: Not used.
        """
        begin = np.array(ee_pose, dtype=np.float64)
        way = twist_between(begin, target_pose, 1.0)
        linear = _PEAK * norm(way[:, :3]) / self._max_velocity
        angular = _PEAK * norm(way[:, 3:]) / self._max_angular_velocity
        duration = np.maximum(np.maximum(linear, angular), self._min_duration)
        return {"start_pose": begin, "duration": duration, "time": np.zeros(len(begin))}

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
        time = np.minimum(state["time"] + dt, state["duration"])
        way = twist_between(state["start_pose"], target_pose, 1.0)
        covered = _share(time / state["duration"])[:, np.newaxis]
        there = integrate(state["start_pose"], way * covered, 1.0)
        wanted = twist_between(ee_pose, there, dt)
        share = slowed(wanted, self._max_velocity, self._max_angular_velocity)
        passed = state["time"] + share * (time - state["time"])
        return wanted * share[:, np.newaxis], {**state, "time": passed}


def _share(time: Array) -> Array:
    """Return the share of the way made by a share of the time, both in [0, 1]."""
    share: Array = time * time * time * (10.0 + time * (6.0 * time - 15.0))
    return share
