"""The `imitation` motion: a demonstrated path, followed from wherever the hand starts."""

import numpy as np

from kinfeas.motion import State
from kinfeas.plugins.learned import Learned
from kinfeas.plugins.limits import norm, positive, slowed
from kinfeas.spatial import Array, compose, twist_between


class Imitation(Learned):
    """Phase dynamic system on R^3 x S^3, in the frame of the handled object.

    The hand is drawn to the point of the learned path that the phase s in [0, 1] stands for, and
    the phase goes on only as the hand is near that point: `s' = psi / T` with `psi =
    exp(-|e_p|^2 / a^2 - |e_r|^2 / b^2)` of the errors in position and orientation. The twist is
    what the phase demands less `gain` times the errors. Where it would exceed a limit, hand and
    phase slow down together. So the hand first comes to the beginning of the path, then moves as
    was demonstrated, from any start, and ends at the learned end exactly.

    Args:
        model: Name of a shipped model, or path of a file that `kinfeas fit` wrote.
        gain: Rate at which errors decay, 1/s.
        position_scale: The length a: the error at which the phase slows down by e, in metres.
        rotation_scale: The same angle b in radians.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.

    Raises:
        KinfeasError: If there is no such model, its file is wrong, or a number is not positive.
    """

    def __init__(
        self,
        *,
        model: str | None = None,
        gain: float = 1.0,
        position_scale: float = 0.05,
        rotation_scale: float = 0.3,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        super().__init__("imitation", model, max_velocity, max_angular_velocity)
        self._gain = positive("gain", gain)
        self._position_scale = positive("position_scale", position_scale)
        self._rotation_scale = positive("rotation_scale", rotation_scale)

    def twist(self, state: State, ee_pose: Array, dt: float) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: World pose that the motion has come to, shape (n, 7).
            dt: Duration of the step in seconds.
        """
        target, phase = state["object_pose"], state["phase"]
        here = compose(target, self._path.at(phase))
        error = twist_between(here, ee_pose, 1.0)
        advance = np.minimum(self._nearness(error) * dt / self._duration, 1.0 - phase)
        there = compose(target, self._path.at(phase + advance))
        # A step longer than 1 / gain would shoot past the path.
        wanted = twist_between(here, there, dt) - min(self._gain, 1.0 / dt) * error
        share = slowed(wanted, self._max_velocity, self._max_angular_velocity)
        after = {"object_pose": target, "phase": phase + share * advance}
        return wanted * share[:, np.newaxis], after

    def _nearness(self, error: Array) -> Array:
        """Return psi in [0, 1], shape (n, 6) -> (n,): how near the hand is to its path."""
        metres, radians = norm(error[:, :3]), norm(error[:, 3:])
        nearness: Array = np.exp(
            -((metres / self._position_scale) ** 2) - (radians / self._rotation_scale) ** 2
        )
        return nearness
