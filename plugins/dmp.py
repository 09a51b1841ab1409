"""The `dmp` motion: a dynamic movement primitive, learned from one demonstration."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from kinfeas.config.quantities import Positive
from kinfeas.core.motion import State
from kinfeas.core.spatial import (
    IDENTITY,
    Array,
    compose,
    continuous,
    integrate,
    relative,
    twist_between,
)
from kinfeas.plugins.limits import slowed
from kinfeas.plugins.replay import read_recording, resampled

_RATE = 12.5  # of the spring's decay in each duration; half of the library's alpha
_SAMPLES = 201  # of the demonstration, at even steps of time
_SEGMENTS = 256  # of the table of forces
_LAST_PHASE = 0.01  # at the end of the demonstrated time; the library's own


class Dmp:
    """A spring that draws the EE to its goal, bent by a learned force that fades away.

    In the frame of the goal, with time in units of the demonstration's duration,
    `v' = alpha (beta (g - y - (g - y_0) z) - v) + f(z)` with `alpha = 4 beta = 25` and a phase `z`
    that falls exponentially (Pastor et al. 2009; rotations as in Ude et al. 2014). A start or a
    goal that differs from the demonstrated one adds a straight motion that fades with the phase,
    and the goal is reached from any start. Where the EE would exceed a limit, its time slows down,
    and the shape of the motion stays.

    Args:
        file: CSV file of the demonstration, or the CSV record of a run of `kinfeas deploy`.
        frame: `goal` puts the end of the motion on the target; with `object` the target is the
            grasped object, and the motion ends relative to it as demonstrated.
        basis_functions: Number of weights of the force in each direction, 2 to 100.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self,
        *,
        file: str,
        frame: Literal["goal", "object"] = "goal",
        basis_functions: Annotated[int, Interval(ge=2, le=100)] = 25,
        max_velocity: Positive = 0.1,
        max_angular_velocity: Positive = 0.1,
    ) -> None:
        self._max_velocity = max_velocity
        self._max_angular_velocity = max_angular_velocity
        time, ee_pose, object_pose = read_recording(Path(file), frame)
        end = ee_pose[-1]
        self._goal = relative(end, object_pose) if frame == "object" else IDENTITY
        self._duration = float(time[-1] - time[0])
        shown = relative(ee_pose, np.broadcast_to(end, ee_pose.shape))
        self._weights = learn(time, shown, basis_functions)

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return the displacement to the goal and the velocity, (n, 6), and the time, (n,)."""
        n = len(target_pose)
        way = _way(relative(ee_pose, compose(target_pose, self._goal)))
        return {"way": way, "velocity": np.zeros((n, 6)), "time": np.zeros(n)}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return compose(target_pose, self._goal)

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array
    ) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        goal = compose(target_pose, self._goal)
        here = relative(ee_pose, goal)
        step = dt / self._duration
        moved, _ = self._move(state, here, step)
        step *= self._kept(moved, dt)
        moved, velocity = self._move(state, here, step)
        # The displacement of a spring does not shrink by the same share as its step.
        moved *= self._kept(moved, dt)[:, np.newaxis]
        there = compose(goal, integrate(here, moved, 1.0))
        twist = twist_between(ee_pose, there, dt)
        return twist, {**state, "velocity": velocity, "time": state["time"] + step}

    def _kept(self, moved: Array, dt: Array) -> Array:
        """Return the share of a displacement, (n, 6), that the limits allow within dt, (n,)."""
        return slowed(moved / dt[:, np.newaxis], self._max_velocity, self._max_angular_velocity)

    def _move(self, state: State, here: Array, step: Array) -> tuple[Array, Array]:
        """Return displacement and next velocity, shape (n, 6), after steps of time, shape (n,).

        The exact solution for a force that is constant during the step, stable at any rate.
        """
        middle = state["time"] + 0.5 * step
        drawn = state["way"] * _phase(middle)[:, np.newaxis]
        rest = drawn - force_at(self._weights, middle) / _RATE**2
        away, by = _way(here) - rest, step[:, np.newaxis]
        pull = _RATE * away - state["velocity"]
        fading = np.exp(-_RATE * by)
        left = (away + pull * by) * fading
        return away - left, (state["velocity"] + _RATE * pull * by) * fading


def _way(here: Array) -> Array:
    """Return the displacement from poses in the goal's frame to the goal, (n, 7) -> (n, 6)."""
    return twist_between(here, np.broadcast_to(IDENTITY, here.shape), 1.0)


def _phase(time: Array) -> Array:
    """Return the phase, which falls from 1 to 0.01 within the duration, shape (n,) -> (n,)."""
    phase: Array = np.exp(np.log(_LAST_PHASE) * time)
    return phase


def force_at(weights: Array, time: Array) -> Array:
    """Return the force, shape (n, 6), in m and rad per squared duration.

    `weights` are the force per phase at even moments in [0, 1], shape (m + 1, 6), and `time` is in
    units of the duration, shape (n,).
    """
    steps = np.minimum(time, 1.0) * (len(weights) - 1)
    i = np.minimum(steps.astype(np.intp), len(weights) - 2)
    share = (steps - i)[:, np.newaxis]
    force = weights[i] * (1.0 - share) + weights[i + 1] * share
    return force * _phase(time)[:, np.newaxis]


def learn(time: Array, poses: Array, basis_functions: int) -> Array:
    """Return the force per phase with which the spring reproduces a motion, shape (m + 1, 6).

    The motion is `poses` in the frame of the goal, shape (t, 7), at strictly ascending seconds.
    """
    from movement_primitives.dmp import CartesianDMP

    moments, table = np.linspace(0.0, 1.0, _SAMPLES), np.linspace(0.0, 1.0, _SEGMENTS + 1)
    model = CartesianDMP(
        1.0,
        1.0 / _SAMPLES,
        basis_functions,
        smooth_scaling=True,
        alpha_y=2.0 * _RATE,
        beta_y=0.5 * _RATE,
    )
    model.imitate(moments, _for_library(resampled(time, poses, moments)))
    force = np.concatenate([model.forcing_term_pos(table), model.forcing_term_rot(table)]).T
    return np.asarray(force / _phase(table)[:, np.newaxis])


def _for_library(poses: Array) -> Array:
    """Return poses with quaternions wxyz, each of the sign that is nearest to the one before."""
    return np.concatenate([poses[:, :3], np.roll(continuous(poses[:, 3:]), 1, axis=1)], axis=1)
