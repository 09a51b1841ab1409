"""The `gaussian_mixture` motion: a clock runs through a learned path, and the hand follows."""

import numpy as np

from kinfeas.core.motion import State
from kinfeas.core.spatial import Array, compose, twist_between
from kinfeas.plugins.limits import slowed
from kinfeas.plugins.model import read_model
from kinfeas.plugins.path import tabulate
from kinfeas.plugins.path_motion import PathMotion
from kinfeas.plugins.phase import PhaseControl


class GaussianMixture(PathMotion):
    """A time-indexed mixture of hand and base poses, in the frame of the handled object.

    Gaussian mixture regression turns time into a reference pose, which the hand follows as fast
    as its limits allow. The clock never waits: where the start is far, the reference runs ahead,
    and the beginning of what was demonstrated is lost (`imitation` keeps it).

    Args:
        model: Path of a file that `kinfeas fit --kind gaussian_mixture` wrote.
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
        learned = read_model(model, "gaussian_mixture")
        control = PhaseControl(
            path=tabulate(learned),
            duration=learned.duration,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )
        super().__init__(control, in_world=False)

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
        control = self._control
        phase = np.minimum(state["phase"] + dt / control.duration, 1.0)
        reference = compose(target_pose, control.path.at(phase))
        wanted = twist_between(ee_pose, reference, dt)
        share = slowed(wanted, control.max_velocity, control.max_angular_velocity)
        return wanted * share[:, np.newaxis], {"phase": phase}

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return where the base was demonstrated to be now, shape (n, 7), in the world.

        Not-a-number if the model was fitted from demonstrations without a base.
        """
        return self._control.path.base_at(state["phase"], target_pose)
