"""The `imitation` motion: a demonstrated path, followed from wherever the hand starts."""

from kinfeas.core.motion import State
from kinfeas.core.spatial import Array
from kinfeas.plugins.model import read_model
from kinfeas.plugins.path import tabulate
from kinfeas.plugins.path_motion import PathMotion
from kinfeas.plugins.phase import PhaseControl


class Imitation(PathMotion):
    """Phase dynamic system on R^3 x S^3, in the frame of the handled object.

    The hand first comes to the beginning of the learned path, then moves as was demonstrated, from
    any start, and ends at the learned end exactly; `PhaseControl` says how.

    Args:
        model: Name of a shipped model (door_grasp, door_open, drawer_grasp or drawer_open), or path
            of a file that `kinfeas fit` wrote.
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
        learned = read_model(model, "imitation")
        control = PhaseControl(
            path=tabulate(learned),
            duration=learned.duration,
            gain=gain,
            position_scale=position_scale,
            rotation_scale=rotation_scale,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )
        super().__init__(control, in_world=False)

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return where the base was demonstrated to be now, shape (n, 7), in the world.

        Not-a-number if the model was fitted from demonstrations without a base.
        """
        return self._control.path.base_at(state["phase"], target_pose)
