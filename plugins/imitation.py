"""The `imitation` motion: a demonstrated path, followed from wherever the hand starts."""

from kinfeas.motion import State
from kinfeas.plugins.learned import Learned
from kinfeas.plugins.phase import PhaseControl
from kinfeas.spatial import Array


class Imitation(Learned):
    """Phase dynamic system on R^3 x S^3, in the frame of the handled object.

    The hand first comes to the beginning of the learned path, then moves as was demonstrated, from
    any start, and ends at the learned end exactly; `PhaseControl` says how.

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
        self._control = PhaseControl(
            path=self._path,
            duration=self._duration,
            gain=gain,
            position_scale=position_scale,
            rotation_scale=rotation_scale,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )

    def twist(self, state: State, ee_pose: Array, dt: float) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state.

        Args:
            state: State of n motions.
            ee_pose: World pose that the motion has come to, shape (n, 7).
            dt: Duration of the step in seconds.
        """
        target = state["object_pose"]
        twist, phase = self._control.step(target, state["phase"], ee_pose, dt)
        return twist, {"object_pose": target, "phase": phase}
