"""The `planned` motion around solids, and the `spline` motion along random curves."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from kinfeas.config.quantities import Count, Distance, Metres, NotNegative, Positive
from kinfeas.core.motion import State
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, distance, integrate, twist_between
from kinfeas.plugins.limits import norm, slowed
from kinfeas.plugins.minimum_jerk import MinimumJerk
from kinfeas.plugins.path_geometry import POINTS, positions_at, shares_ahead
from kinfeas.plugins.path_search import replan_batch

_MOVED = 0.05
"""Metres that a target may move before its path is planned anew; paths bend along until then."""

_MOMENT = 0.05
"""Seconds over which the velocity is measured when the path changes."""


class SmoothPath:
    """Motion along a path of its own for each start, from rest to rest.

    A path is a cubic B-spline. The speed rises and falls along quintic ramps. Orientations follow
    the slerp, in step with the way. A path may change on the way; its beginning then has the twist
    of the motion before.

    Args:
        ramp: Seconds from rest to full speed, and from full speed to rest.
        min_duration: Shortest duration of a straight motion, seconds.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self, ramp: float, min_duration: float, max_velocity: float, max_angular_velocity: float
    ) -> None:
        self._ramp = ramp
        self._max_velocity, self._max_angular_velocity = max_velocity, max_angular_velocity
        self._straight = MinimumJerk(
            min_duration=min_duration,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return straight motions.

        The keys are those of `minimum_jerk`; the target of the plan, shape (n, 7); its control
        points, (n, 64, 3); its rates at the beginning and on the way as shares of the path in a
        second, (n,), 0 for straight motions; and the twist, (n, 6), by which the motion before
        differs from the beginning of the plan.
        """
        state = self._straight.start(ee_pose, target_pose, rngs)
        n = len(target_pose)
        begin, end = state["start_pose"][:, np.newaxis, :3], target_pose[:, np.newaxis, :3]
        share = np.linspace(0.0, 1.0, POINTS)[:, np.newaxis]
        return {
            **state,
            "planned_target": np.array(target_pose, dtype=np.float64),
            "points": begin + share * (end - begin),
            "first_rate": np.zeros(n),
            "rate": np.zeros(n),
            "drift": np.zeros((n, 6)),
        }

    def goal_pose(self, state: State, target_pose: Array) -> Array:
        """Return the targets, shape (n, 7)."""
        return np.array(target_pose, dtype=np.float64)

    def twist(
        self, state: State, ee_pose: Array, target_pose: Array, dt: Array
    ) -> tuple[Array, State]:
        """Return the world twist for the next `dt` seconds, shape (n, 6), and the next state."""
        time = np.minimum(state["time"] + dt, state["duration"])
        wanted = twist_between(ee_pose, self._at(state, target_pose, time), dt)
        share = slowed(wanted, self._max_velocity, self._max_angular_velocity)
        passed = state["time"] + share * (time - state["time"])
        return wanted * share[:, np.newaxis], {**state, "time": passed}

    def ahead(self, state: State, ee_pose: Array, target_pose: Array, distances: Array) -> Array:
        """Return the poses that lie ahead on the paths, (n, 7) and (d,) -> (n, d, 7)."""
        shares = np.empty((len(ee_pose), len(distances)))
        now = self._share(state, state["time"])
        shares_ahead(state["points"], now, np.asarray(distances, dtype=np.float64), shares)
        poses = [self._on_path(state, target_pose, column) for column in shares.T]
        return np.stack(poses, axis=1) if poses else np.empty((len(ee_pose), 0, 7))

    def _begin(
        self, state: State, ee_pose: Array, target_pose: Array, points: Array, velocity: Array
    ) -> State:
        """Return the state at the beginning of new paths, at a twist, shape (n, 6)."""
        way = twist_between(ee_pose, target_pose, 1.0)
        steps = points[:, 1:] - points[:, :-1]
        x, y, z = steps[..., 0], steps[..., 1], steps[..., 2]
        length = np.sqrt(x * x + y * y + z * z).max(axis=1) * (POINTS - 1)
        seconds = np.maximum(
            length / self._max_velocity, norm(way[:, 3:]) / self._max_angular_velocity
        )
        tangent = np.concatenate([steps[:, 0] * (POINTS - 1), way[:, 3:]], axis=1)  # per share
        squared = np.maximum(norm(tangent) ** 2, 1e-12)
        forward = velocity[:, 0] * tangent[:, 0] + velocity[:, 1] * tangent[:, 1]
        first = np.maximum(forward + velocity[:, 2] * tangent[:, 2], 0.0) / squared
        first = np.minimum(first, 1.0 / np.maximum(seconds, self._ramp))
        rate = np.minimum(1.0 / np.maximum(seconds, 1e-6), 1.0 / self._ramp - first / 2.0)
        rate = np.maximum(rate, first)
        state = {
            **state,
            "start_pose": np.array(ee_pose, dtype=np.float64),
            "planned_target": np.array(target_pose, dtype=np.float64),
            "points": points,
            "first_rate": first,
            "rate": rate,
            "time": np.zeros(len(rate)),
            "drift": velocity - first[:, np.newaxis] * tangent,
        }
        rise, cruise, fall = self._phases(state)
        return {**state, "duration": rise + cruise + fall}

    def _phases(self, state: State) -> tuple[Array, Array, Array]:
        """Return the seconds in which the rate changes, is constant, and falls to rest, (n,)."""
        first, rate = state["first_rate"], np.maximum(state["rate"], 1e-9)
        rise = np.where(first == rate, 0.0, self._ramp)
        fall = np.minimum(self._ramp, 2.0 / rate)
        cruise = (1.0 - 0.5 * rise * (first + rate) - 0.5 * fall * rate) / rate
        return rise, np.maximum(cruise, 0.0), fall

    def _share(self, state: State, time: Array) -> Array:
        """Return the shares of the paths that are behind the EE after some seconds, (n,)."""
        s = time / state["duration"]
        straight = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        first, rate = state["first_rate"], state["rate"]
        rise, cruise, fall = self._phases(state)
        u = np.minimum(time / np.maximum(rise, 1e-9), 1.0)
        v = np.clip((time - rise - cruise) / np.maximum(fall, 1e-9), 0.0, 1.0)
        share = np.where(rise > 0.0, rise * (first * u + (rate - first) * _ramped(u)), 0.0)
        share = share + rate * np.clip(time - rise, 0.0, cruise)
        share = share + rate * fall * (v - _ramped(v))
        return np.where(rate > 0.0, np.minimum(share, 1.0), straight)

    def _at(self, state: State, target_pose: Array, time: Array) -> Array:
        """Return the poses of the motions after some seconds, shape (n, 7)."""
        pose = self._on_path(state, target_pose, self._share(state, time))
        fade = np.minimum(self._ramp, state["duration"])
        left = np.maximum(1.0 - time / fade, 0.0)
        return integrate(pose, state["drift"] * (time * left * left * left)[:, np.newaxis], 1.0)

    def _on_path(self, state: State, target_pose: Array, share: Array) -> Array:
        """Return the poses at shares of the paths, which end at the current targets, (n, 7)."""
        way = twist_between(state["start_pose"], target_pose, 1.0)
        pose = integrate(state["start_pose"], way * share[:, np.newaxis], 1.0)
        position = np.empty((len(share), 3))
        positions_at(state["points"], share, position)
        moved = (target_pose - state["planned_target"])[:, :3]
        pose[:, :3] = position + share[:, np.newaxis] * moved
        return pose


class Planned(SmoothPath):
    """Motion around solids, from rest to rest.

    The path is the cheapest one of a sphere around the EE: A* on a grid of x, y and heights, with
    shortcuts and rounded corners. A metre costs up to 17 times as much where a solid is nearer than
    `clearance` to its side, since the base has to pass, too. Without solids the motion is that of
    `minimum_jerk`; without a path it is straight. A new plan replaces one that comes too near to a
    solid, or that has become expensive.

    Args:
        radius: Radius of the sphere around the EE that stays free of solids, metres.
        clearance: Preferred horizontal distance of the EE from solids, metres.
        min_height: Lowest z of the EE on a detour, metres, unless start or goal are lower.
        max_height: Highest z on a detour, likewise.
        foresight: Seconds for which moving solids take the room that they move into.
        ramp: Seconds from rest to full speed, and from full speed to rest, around solids.
        min_duration: Shortest duration of a straight motion, seconds.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(  # noqa: PLR0913 - keyword parameters of a YAML file
        self,
        *,
        radius: Positive = 0.15,
        clearance: Positive = 0.9,
        min_height: Metres = 0.4,
        max_height: Metres = 1.2,
        foresight: NotNegative = 5.0,
        ramp: Positive = 4.0,
        min_duration: Positive = 1.0,
        max_velocity: Positive = 0.1,
        max_angular_velocity: Positive = 0.1,
    ) -> None:
        super().__init__(ramp, min_duration, max_velocity, max_angular_velocity)
        self._limits = np.array([radius, clearance, min_height, max_height, foresight])

    def replan(self, state: State, ee_pose: Array, target_pose: Array, solids: Solids) -> State:
        """Return the state of motions around the solids as they stand now."""
        share = self._share(state, state["time"])
        moved = distance(state["planned_target"], target_pose)[0]
        new = (state["rate"] > 0.0) & (moved < _MOVED)
        points = state["points"].copy()
        places = tuple(
            np.ascontiguousarray(one)
            for one in (solids.pose, solids.size, solids.cylinder, solids.velocity)
        )
        here, end = (np.ascontiguousarray(pose[:, :3]) for pose in (ee_pose, target_pose))
        replan_batch(new, share, here, end, places, self._limits, points)
        soon = np.minimum(state["time"] + _MOMENT, state["duration"])
        then = self._at(state, target_pose, soon)
        velocity = twist_between(self._at(state, target_pose, state["time"]), then, _MOMENT)
        velocity = np.where(state["time"][:, np.newaxis] > 0.0, velocity, 0.0)
        begun = self._begin(state, ee_pose, target_pose, points, velocity)
        chosen = {
            key: np.where(new.reshape(-1, *[1] * (values.ndim - 1)), begun[key], values)
            for key, values in state.items()
        }
        return chosen


class RandomSpline(SmoothPath):
    """Motion along a smooth random curve to the target, from rest to rest.

    Args:
        bends: Number of points between start and target through which the curve passes.
        spread: Largest distance of these points from the straight line along each horizontal axis,
            metres; a third of it along the vertical.
        ramp: Seconds from rest to full speed, and from full speed to rest.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self,
        *,
        bends: Count = 3,
        spread: Distance = 0.5,
        ramp: Positive = 4.0,
        max_velocity: Positive = 0.1,
        max_angular_velocity: Positive = 0.1,
    ) -> None:
        super().__init__(ramp, ramp, max_velocity, max_angular_velocity)
        self._bends, self._spread = bends, np.array([spread, spread, spread / 3.0])

    def start(
        self, ee_pose: Array, target_pose: Array, rngs: Sequence[np.random.Generator]
    ) -> State:
        """Return motions along random curves, a state as that of `SmoothPath`."""
        state = super().start(ee_pose, target_pose, rngs)
        knots = np.linspace(0.0, 1.0, self._bends + 2)
        points = np.empty_like(state["points"])
        for row, rng in enumerate(rngs):
            begin, end = ee_pose[row, :3], target_pose[row, :3]
            bends = begin + knots[:, np.newaxis] * (end - begin)
            bends[1:-1] += self._spread * rng.uniform(-1.0, 1.0, (self._bends, 3))
            points[row] = _even(CubicSpline(knots, bends)(np.linspace(0.0, 1.0, 16 * POINTS)))
        rest = np.zeros((len(rngs), 6))
        return self._begin(state, ee_pose, target_pose, points, rest)


def _even(curve: Array) -> Array:
    """Return points at even steps along a finely sampled curve, shape (m, 3) -> (64, 3)."""
    length = np.concatenate([[0.0], np.cumsum(norm(np.diff(curve, axis=0)))])
    at = np.linspace(0.0, length[-1], POINTS)
    return np.stack([np.interp(at, length, axis) for axis in curve.T], axis=1)


def _ramped(u: Array) -> Array:
    """Return the integral of the quintic step `10 u^3 - 15 u^4 + 6 u^5` from 0 to u in [0, 1]."""
    return u * u * u * u * (2.5 + u * (u - 3.0))
