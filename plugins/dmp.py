"""The `dmp` motion: a dynamic movement primitive, learned from one demonstration."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import State
from kinfeas.core.spatial import IDENTITY, Array, compose, integrate, relative, twist_between
from kinfeas.plugins.forcing import Forcing, learn
from kinfeas.plugins.limits import positive, slowed
from kinfeas.plugins.path_motion import checked_frame
from kinfeas.plugins.recording import read_recording

_RATE = 12.5  # of the spring's decay in each duration; half of the library's alpha


class Dmp:
    """A spring that draws the EE to its goal, bent by a learned force that fades away.

    In the frame of the goal, with time in units of the demonstration's duration,
    `v' = alpha (beta (g - y - (g - y_0) z) - v) + f(z)` with `alpha = 4 beta = 25` and a phase `z`
    that falls exponentially (Pastor et al. 2009; rotations as in Ude et al. 2014). So a start or a
    goal that differs from the demonstrated one adds a straight way that fades in step with the
    phase, and the goal is reached from any start. Where the EE would exceed a limit, its time
    slows down, and the shape of the motion stays.

    Args:
        file: CSV or NPZ file of the demonstration, or the CSV record of a run of `kinfeas deploy`.
        frame: `goal` has the target as the end; `object` has it as the handled object, about
            which the motion ends as demonstrated.
        basis_functions: How many numbers describe the force in each direction, at least 2.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.

    Raises:
        KinfeasError: If `movement_primitives` is missing, the file is wrong, there is no such
            frame or a number is not positive.
    """

    def __init__(
        self,
        *,
        file: str,
        frame: str = "goal",
        basis_functions: int = 25,
        max_velocity: float = 0.1,
        max_angular_velocity: float = 0.1,
    ) -> None:
        self._max_velocity = positive("max_velocity", max_velocity)
        self._max_angular_velocity = positive("max_angular_velocity", max_angular_velocity)
        if checked_frame(frame) == "world":
            raise KinfeasError("frame must be 'goal' or 'object' here, not 'world'")
        time, ee_pose, object_pose = read_recording(Path(file), checked_frame(frame))
        end = ee_pose[-1]
        self._goal = relative(end, object_pose) if frame == "object" else IDENTITY
        self._duration = float(time[-1] - time[0])
        shown = relative(ee_pose, np.broadcast_to(end, ee_pose.shape))
        self._forcing: Forcing = learn(time, shown, basis_functions, 2.0 * _RATE)

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the state of n motions: way from start to goal, velocity and time.

        Args:
            ee_pose: World pose of the driven frame, shape (n, 7).
            target_pose: World pose of the goal or the handled object, shape (n, 7).
            rngs: Not used.
        """
        n = len(target_pose)
        way = _way(relative(ee_pose, compose(target_pose, self._goal)))
        return {"way": way, "velocity": np.zeros((n, 6)), "time": np.zeros(n)}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return compose(target_pose, self._goal)

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
        goal = compose(target_pose, self._goal)
        here = relative(ee_pose, goal)
        step = dt / self._duration
        moved, _ = self._move(state, here, step)
        step *= self._kept(moved, dt)
        moved, velocity = self._move(state, here, step)
        # A shorter step of a spring is not shorter by the same share.
        moved *= self._kept(moved, dt)[:, np.newaxis]
        there = compose(goal, integrate(here, moved, 1.0))
        twist = twist_between(ee_pose, there, dt)
        return twist, {**state, "velocity": velocity, "time": state["time"] + step}

    def _kept(self, moved: Array, dt: Array) -> Array:
        """Return the share of a displacement, (n, 6), that the limits allow within dt, (n,)."""
        return slowed(moved / dt[:, np.newaxis], self._max_velocity, self._max_angular_velocity)

    def _move(self, state: State, here: Array, step: Array) -> tuple[Array, Array]:
        """Return displacement and next velocity, shape (n, 6), after steps of time, shape (n,).

        The exact solution for a force that stands still in the meantime, so that no rate of
        control is too slow.
        """
        middle = state["time"] + 0.5 * step
        drawn = state["way"] * self._forcing.phase(middle)[:, np.newaxis]
        rest = drawn - self._forcing.at(middle) / _RATE**2
        away, by = _way(here) - rest, step[:, np.newaxis]
        pull = _RATE * away - state["velocity"]
        fading = np.exp(-_RATE * by)
        left = (away + pull * by) * fading
        return away - left, (state["velocity"] + _RATE * pull * by) * fading


def _way(here: Array) -> Array:
    """Return the displacement from poses in the goal's frame to the goal, (n, 7) -> (n, 6)."""
    return twist_between(here, np.broadcast_to(IDENTITY, here.shape), 1.0)
