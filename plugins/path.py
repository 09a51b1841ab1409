"""Paths of the EE, the phase dynamic system that follows them, and limits of velocity."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.metrics import GOAL_METRES, GOAL_RADIANS
from kinfeas.core.motion import Rngs, State, TwistAndState
from kinfeas.core.spatial import (
    IDENTITY,
    Array,
    compose,
    integrate,
    planar_pose,
    relative,
    twist_between,
)

Frame = Literal["object", "goal", "world"]
"""Frame of a path: the target as the grasped object, the target as its end, or the world."""

FIRST = 0.2
"""`PathMotion.first` of paths whose first pose counts: 1 cm and 0.06 rad."""

_END_SECONDS = 1.0
"""Most remaining seconds that count as the end of a path, within the tolerances of a goal."""

_FINEST = 0.05  # seconds from knot to knot, if the path is not too long for that
_MOST_SEGMENTS = 20_000
_ROUNDING = 1e-9
_TINY = 1e-12  # keeps quotients finite; in m/s and in rad/s


def slowed(twist: Array, max_velocity: float, max_angular_velocity: float) -> Array:
    """Return the factor in (0, 1] by which twists, (n, 6), must shrink to keep both limits, (n,).

    Limits and twists are in m/s and rad/s.
    """
    linear = max_velocity / np.maximum(norm(twist[:, :3]), _TINY)
    angular = max_angular_velocity / np.maximum(norm(twist[:, 3:]), _TINY)
    return np.minimum(1.0, np.minimum(linear, angular))


def norm(vector: Array) -> Array:
    """Return lengths, shape (n, 3) -> (n,); by elements, so that no row depends on the batch."""
    x, y, z = vector[:, 0], vector[:, 1], vector[:, 2]
    return np.sqrt(x * x + y * y + z * z)


class PosePath:
    """EE poses `knots`, shape (m + 1, 7), at even steps of an index in [0, 1].

    `base` is x, y and unwrapped yaw, (m + 1, 3), or None. `segments` are the twists that lead from
    each knot to the next in one second, (m, 6).
    """

    def __init__(self, knots: Array, base: Array | None = None) -> None:
        self.knots, self.base = knots, base
        self.segments = twist_between(knots[:-1], knots[1:], 1.0)

    def at(self, index: Array) -> Array:
        """Return the EE poses at `index` in [0, 1], shape (n,) -> (n, 7)."""
        i, fraction = self._segment(index)
        return integrate(self.knots[i], self.segments[i] * fraction[:, np.newaxis], 1.0)

    def base_at(self, index: Array, object_pose: Array) -> Array:
        """Return the world poses of the base at `index`, shape (n, 7), NaN without a base.

        `object_pose` is the world pose of the object whose frame the path is in, shape (n, 7).
        """
        if self.base is None:
            return np.full((len(index), 7), np.nan)
        i, fraction = self._segment(index)
        base = self.base[i] + (self.base[i + 1] - self.base[i]) * fraction[:, np.newaxis]
        pose = planar_pose(base[:, 0], base[:, 1], base[:, 2])
        return compose(below(object_pose), pose)

    def _segment(self, index: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the segments that contain `index`, and the fraction of each that is passed."""
        count = len(self.segments)
        steps = index * count
        i = np.minimum(steps.astype(np.intp), count - 1)
        return i, steps - i


@dataclass(eq=False, kw_only=True)
class PathMotion:
    """Motions along one path: a phase dynamic system on R^3 x S^3.

    The EE is drawn to the point of the path at the phase s in [0, 1], and the phase advances as
    far as the EE is near that point: `s' = psi / T` with `psi = exp(-|e_p|^2 / a^2 - |e_r|^2 /
    b^2)` of the errors in position and orientation. The twist is that of the path less `gain` times
    the errors. Where it would exceed a limit, EE and phase slow down together. So from any start
    the EE first comes to the beginning of the path, then moves along it and ends at its end
    exactly. The state holds the phase. A motion is finished when at most 1 s, 0.025 m and
    12 degrees of its path are left; one that does not wait for the EE (`a` is infinite), at its
    end.
    """

    path: PosePath  # in the frame of the target, or in the world
    duration: float  # the time T in seconds that the path takes an EE that is on it
    in_world: bool = False  # whether the path stays where it is when the target moves
    gain: float = 1.0  # rate at which errors decay, 1/s
    # the length a: the error at which the phase slows down by e, in metres
    position_scale: float = 0.05
    rotation_scale: float = 0.3  # the same angle b in radians
    first: float = math.inf  # largest error, in units of a and b, at which the phase leaves 0
    max_velocity: float = 0.1  # upper limit of the speed in m/s
    max_angular_velocity: float = 0.1  # upper limit of the angular speed in rad/s
    _end: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the phase from which on the rest of the path counts as its end."""
        if math.isinf(self.position_scale):
            self._end = 1.0 - _ROUNDING
            return
        parts = self.path.segments
        limits = (GOAL_METRES, norm(parts[:, :3])), (GOAL_RADIANS, norm(parts[:, 3:]))
        seconds = np.full(len(parts), self.duration / len(parts))
        beyond = [
            int(np.sum(np.cumsum(each[::-1]) > most))
            for most, each in (*limits, (_END_SECONDS, seconds))
        ]
        self._end = max(beyond) / len(parts) - _ROUNDING

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return the state of n motions, phases of 0."""
        return {"phase": np.zeros(len(target_pose))}

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the world poses at which the motions end, shape (n, 7)."""
        return compose(self._frame(target_pose), self.path.knots[-1])

    def finished(self, state: State, target_pose: Array) -> NDArray[np.bool_]:
        """Return whether the motions are at the end of the path, shape (n,)."""
        return state["phase"] >= self._end

    def base_pose(self, state: State, target_pose: Array) -> Array:
        """Return the demonstrated base poses, shape (n, 7), in the world; NaN without a base."""
        return self.path.base_at(state["phase"], target_pose)

    def twist(self, state: State, ee_pose: Array, target_pose: Array, dt: Array) -> TwistAndState:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        frame, phase = self._frame(target_pose), state["phase"]
        here = compose(frame, self.path.at(phase))
        error = twist_between(here, ee_pose, 1.0)
        metres, radians = norm(error[:, :3]), norm(error[:, 3:])
        away = (metres / self.position_scale) ** 2 + (radians / self.rotation_scale) ** 2
        psi = np.where((phase == 0.0) & (away > self.first**2), 0.0, np.exp(-away))
        advance = np.minimum(psi * dt / self.duration, 1.0 - phase)
        # A step longer than 1 / gain would overshoot the path.
        correction = error * np.minimum(self.gain, 1.0 / dt)[:, np.newaxis]
        twist, scale = self._along(here, frame, phase + advance, dt, correction)
        if (scale < 1.0).any():  # the chord of the whole advance would leave a curved path
            advance, correction = scale * advance, correction * scale[:, np.newaxis]
            twist, scale = self._along(here, frame, phase + advance, dt, correction)
        return twist * scale[:, np.newaxis], {"phase": phase + scale * advance}

    def _along(
        self, here: Array, frame: Array, phase: Array, dt: Array, correction: Array
    ) -> tuple[Array, Array]:
        """Return twists from poses to those at a phase, corrected, and how they must shrink."""
        twist = twist_between(here, compose(frame, self.path.at(phase)), dt) - correction
        return twist, slowed(twist, self.max_velocity, self.max_angular_velocity)

    def _frame(self, target_pose: Array) -> Array:
        return np.broadcast_to(IDENTITY, target_pose.shape) if self.in_world else target_pose


def in_frame(poses: Array, frame: Frame, object_pose: Array) -> Array:
    """Return a path, shape (m, 7), relative to its `frame`.

    `object_pose` is the grasped object in the same frame as `poses`, shape (7,).
    """
    origins = {"object": object_pose, "goal": poses[-1], "world": IDENTITY}
    return relative(poses, origins[frame])


def even_fractions(duration: float) -> Array:
    """Return the fractions of a path of `duration` seconds at its knots, shape (m + 1,)."""
    segments = min(max(256, math.ceil(duration / _FINEST)), _MOST_SEGMENTS)
    return np.linspace(0.0, 1.0, segments + 1)


def below(pose: Array) -> Array:
    """Return the frames on the floor below `pose`, shape (n, 7), with the heading of its x axis."""
    x, y, z, w = pose[:, 3], pose[:, 4], pose[:, 5], pose[:, 6]
    heading = np.arctan2(2.0 * (x * y + z * w), w * w + x * x - y * y - z * z)
    return planar_pose(pose[:, 0], pose[:, 1], heading)
