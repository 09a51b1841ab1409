"""What motions learned from demonstrations share: a path, how far along it they are, and limits."""

from collections.abc import Sequence

import numpy as np

from kinfeas.motion import State
from kinfeas.plugins.limits import positive
from kinfeas.plugins.model import read_model
from kinfeas.plugins.path import tabulate
from kinfeas.spatial import Array, compose


class Learned:
    """A learned path in the frame of the handled object, and where on it each motion is.

    The state holds the world pose of the object and the phase in [0, 1], the share of the path
    that is behind the hand.
    """

    def __init__(
        self, kind: str, model: str | None, max_velocity: float, max_angular_velocity: float
    ) -> None:
        """Read the model; the limits are in m/s and rad/s.

        Raises:
            KinfeasError: If there is no such model, its file is wrong or of another kind, or a
                limit is not positive.
        """
        self._max_velocity = positive("max_velocity", max_velocity)
        self._max_angular_velocity = positive("max_angular_velocity", max_angular_velocity)
        learned = read_model(model, kind)
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
        return {"object_pose": target, "phase": np.zeros(len(target))}

    def goal_pose(self, state: State) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return compose(state["object_pose"], self._path.knots[-1])

    def base_pose(self, state: State) -> Array:
        """Return where the base was demonstrated to be now, shape (n, 7), in the world.

        Not-a-number if the model was fitted from demonstrations without a base.
        """
        return self._path.base_at(state["phase"], state["object_pose"])
