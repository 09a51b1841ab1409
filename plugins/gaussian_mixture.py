"""The `gaussian_mixture` motion: a clock runs through a learned path, and the hand follows."""

import numpy as np

from kinfeas.motion import State
from kinfeas.plugins.learned import Learned
from kinfeas.plugins.limits import slowed
from kinfeas.spatial import Array, compose, twist_between


class GaussianMixture(Learned):
    """A time-indexed mixture of hand and base poses, in the frame of the handled object.

    Gaussian mixture regression turns time into a reference pose, which the hand follows as fast
    as its limits allow. The clock never waits: where the start is far, the reference runs ahead,
    and the beginning of what was demonstrated is lost (`imitation` keeps it).

    Args:
        model: Name of a shipped model, or path of a file that `kinfeas fit` wrote.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.

    Raises:
        KinfeasError: If there is no such model, its file is wrong, or a number is not positive.
    """

    def __init__(
        self,
        *,
        model: str | None = None,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        super().__init__("gaussian_mixture", model, max_velocity, max_angular_velocity)

    def twist(self, state: State, ee_pose: Array, dt: float) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: World pose that the motion has come to, shape (n, 7).
            dt: Duration of the step in seconds.
        """
        target = state["object_pose"]
        phase = np.minimum(state["phase"] + dt / self._duration, 1.0)
        reference = compose(target, self._path.at(phase))
        wanted = twist_between(ee_pose, reference, dt)
        share = slowed(wanted, self._max_velocity, self._max_angular_velocity)
        return wanted * share[:, np.newaxis], {"object_pose": target, "phase": phase}
