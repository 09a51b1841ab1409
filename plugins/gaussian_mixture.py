"""The `gaussian_mixture` motion: a clock runs through a learned path, and the hand follows."""

from collections.abc import Sequence

import numpy as np

from kinfeas.motion import State
from kinfeas.plugins.limits import positive, slowed
from kinfeas.plugins.model import read_model
from kinfeas.plugins.path import tabulate
from kinfeas.spatial import Array, compose, twist_between


class GaussianMixture:
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
        self._max_velocity = positive("max_velocity", max_velocity)
        self._max_angular_velocity = positive("max_angular_velocity", max_angular_velocity)
        learned = read_model(model, "gaussian_mixture")
        self._path, self._duration = tabulate(learned), learned.duration

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions.

        Args:
            ee_pose: World pose of the driven frame, shape (n, 7); not used.
            target_pose: World pose of the handled object, shape (n, 7).
            rngs: Not used.
        """
        target = np.array(target_pose, dtype=np.float64)
        return {"object_pose": target, "time": np.zeros(len(target))}

    def goal_pose(self, state: State) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return compose(state["object_pose"], self._path.knots[-1])

    def base_pose(self, state: State) -> Array:
        """Return where the base was demonstrated to be now, shape (n, 7), in the world.

        Not-a-number if the model was fitted from demonstrations without a base.
        """
        return self._path.base_at(state["time"] / self._duration, state["object_pose"])

    def twist(self, state: State, ee_pose: Array, dt: float) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: World pose that the motion has come to, shape (n, 7).
            dt: Duration of the step in seconds.
        """
        target = state["object_pose"]
        time = np.minimum(state["time"] + dt, self._duration)
        reference = compose(target, self._path.at(time / self._duration))
        wanted = twist_between(ee_pose, reference, dt)
        share = slowed(wanted, self._max_velocity, self._max_angular_velocity)
        return wanted * share[:, np.newaxis], {"object_pose": target, "time": time}
