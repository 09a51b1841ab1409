"""The motion `swirl`: to the target, and around it on the way."""

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import twist_between


class Swirl:
    """To the target on a spiral about the vertical through it."""

    def __init__(
        self,
        *,
        gain: float = 0.3,
        swirl: float = 0.5,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        if gain <= 0.0:
            raise KinfeasError(f"gain must be positive, not {gain:g}")
        self.gain, self.swirl = gain, swirl
        self.max_velocity, self.max_angular_velocity = max_velocity, max_angular_velocity

    def start(self, ee_pose, target_pose, rngs):
        return {}

    def goal_pose(self, state, target_pose):
        return target_pose

    def twist(self, state, ee_pose, target_pose, dt):
        way = twist_between(ee_pose, target_pose, 1.0)
        toward, turn = way[:, :3], way[:, 3:]
        around = self.swirl * np.stack([-toward[:, 1], toward[:, 0], 0.0 * toward[:, 2]], axis=1)
        gain = np.minimum(self.gain, 0.5 / dt)[:, np.newaxis]
        linear = _shortened(gain * (toward + around), self.max_velocity)
        angular = _shortened(gain * turn, self.max_angular_velocity)
        return np.concatenate([linear, angular], axis=1), dict(state)


def _shortened(vectors, longest):
    """Return vectors, shape (n, 3), none of them longer than `longest`."""
    length = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return vectors * np.minimum(1.0, longest / np.maximum(length, 1e-12))
