"""Motions around solids, `planned` and `whole_body`, and along random curves, `spline`."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from kinfeas.core.metrics import GOAL_METRES
from kinfeas.core.motion import Rngs, State, WholeBodyPath, merged, of_rows
from kinfeas.core.quantities import Count, Distance, Metres, NotNegative, Positive
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import (
    Array,
    continuous,
    distance,
    integrate,
    interpolated_columns,
    twist_between,
)
from kinfeas.planning.ee_path import EePathSettings, plan_ee_paths
from kinfeas.planning.spline import (
    POINTS,
    duration,
    fraction_after,
    fractions_ahead,
    pose_at,
    position_at,
)
from kinfeas.plugins.minimum_jerk import MinimumJerk
from kinfeas.plugins.path import norm

_MOVED = 0.05
"""Metres that a target may move before its path is planned anew; until then it is bent."""

_MOMENT = 0.05  # seconds over which the velocity is measured when the path changes


class SmoothPath(MinimumJerk):
    """Motion along a path of its own for each start, from rest to rest.

    A path is a cubic B-spline of positions and quaternions. The speed rises and falls along quintic
    ramps. A new path begins with the twist of the motion that it replaces.

    Args:
        ramp: Seconds from rest to full speed, and from full speed to rest.
        min_duration: Shortest duration of a straight motion, seconds.
        max_velocity: Upper limit of the speed in m/s.
        max_angular_velocity: Upper limit of the angular speed in rad/s.
    """

    def __init__(
        self, ramp: float, min_duration: float, max_velocity: float, max_angular_velocity: float
    ) -> None:
        super().__init__(
            min_duration=min_duration,
            max_velocity=max_velocity,
            max_angular_velocity=max_angular_velocity,
        )
        self._ramp = ramp

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return straight motions.

        The keys are those of `minimum_jerk`; the target of the plan, shape (n, 7); its control
        points, (n, 64, 7); its rates at the beginning and later, as fractions of the path
        per second, (n,), 0 for straight motions; and the twist, (n, 6), of the replaced motion
        relative to that at the beginning of the plan.
        """
        state = super().start(ee_pose, target_pose, rngs)
        n = len(target_pose)
        return {
            **state,
            "planned_target": np.array(target_pose, dtype=np.float64),
            "points": _slerped(state["start_pose"], target_pose),
            "first_rate": np.zeros(n),
            "rate": np.zeros(n),
            "drift": np.zeros((n, 6)),
        }

    def finished(self, state: State, target_pose: Array) -> NDArray[np.bool_]:
        """Return whether at most 0.025 m of the paths are left, shape (n,)."""
        fraction = np.empty((len(target_pose), 1))
        now = self._fraction(state, state["time"])
        fractions_ahead(state["points"], now, np.array([GOAL_METRES]), fraction)
        return fraction[:, 0] >= 1.0

    def ahead(self, state: State, ee_pose: Array, target_pose: Array, distances: Array) -> Array:
        """Return the poses that lie ahead on the paths, (n, 7) and (d,) -> (n, d, 7)."""
        fractions = np.empty((len(ee_pose), len(distances)))
        now = self._fraction(state, state["time"])
        fractions_ahead(state["points"], now, np.asarray(distances, dtype=np.float64), fractions)
        return self._on_path(state, target_pose, fractions.T).swapaxes(0, 1)

    def _begin(
        self,
        state: State,
        poses: tuple[Array, Array],
        points: Array,
        velocity: Array,
        least_seconds: Array | float = 0.0,
    ) -> State:
        """Return the state at the beginning of new paths, control points of shape (n, 64, 7).

        A motion is at the fraction f(t) of its path p(f): from its first rate r, f' rises within
        `ramp` to a rate R, and falls to 0 as fast. With the tangent p' at the beginning, and the
        time T that the path takes at the velocity limits,

            v = r p' + drift,  r = min(max(v . p' / |p'|^2, 0), 1 / max(T, ramp)),
            R = max(min(1 / T, 1 / ramp - r / 2), r),

        with the scalar products of positions alone. Both ramps take ramp (R + r / 2) <= 1 of the
        path, unless r is larger than R would be.

        Args:
            state: As of `start`.
            poses: Of EE and target.
            points: Control points of the paths.
            velocity: Twist v at the beginning, shape (n, 6).
            least_seconds: Least T.
        """
        (ee_pose, target_pose), pieces = poses, POINTS - 1
        shortest = self._seconds(points[:, :-1], points[:, 1:]).max(axis=1) * pieces
        seconds = np.maximum(shortest, least_seconds)
        linear = (points[:, 1, :3] - points[:, 0, :3]) * pieces
        angular = twist_between(points[:, 0], points[:, 1], 1.0 / pieces)[:, 3:]
        tangent = np.concatenate([linear, angular], axis=1)
        x, y, z = (velocity[:, :3] * linear).T  # by elements, so that no row depends on the batch
        first = np.maximum(x + y + z, 0.0) / np.maximum(norm(linear) ** 2, 1e-12)
        first = np.minimum(first, 1.0 / np.maximum(seconds, self._ramp))
        rate = np.minimum(1.0 / np.maximum(seconds, 1e-6), 1.0 / self._ramp - first / 2.0)
        rate = np.maximum(rate, first)
        return {
            **state,
            "start_pose": np.array(ee_pose, dtype=np.float64),
            "planned_target": np.array(target_pose, dtype=np.float64),
            "points": points,
            "first_rate": first,
            "rate": rate,
            "time": np.zeros(len(rate)),
            "drift": velocity - first[:, np.newaxis] * tangent,
            "duration": duration(first, rate, self._ramp),
        }

    def _fraction(self, state: State, time: Array) -> Array:
        rates = state["first_rate"], state["rate"]
        return fraction_after(time, state["duration"], *rates, self._ramp)

    def _at(self, state: State, target_pose: Array, time: Array) -> Array:
        pose = self._on_path(state, target_pose, self._fraction(state, time))
        fade = np.minimum(self._ramp, state["duration"])
        left = np.maximum(1.0 - time / fade, 0.0)
        return integrate(pose, state["drift"] * (time * left * left * left)[:, np.newaxis], 1.0)

    def _on_path(self, state: State, target_pose: Array, fraction: Array) -> Array:
        """Return the poses at fractions of the paths, which end at the current targets.

        Shape (..., n) -> (..., n, 7).
        """
        straight = state["rate"][:, np.newaxis] == 0.0
        origin = np.where(straight, state["start_pose"], state["planned_target"])
        return pose_at(state["points"], fraction, state["rate"], origin, target_pose)

    def _velocity(self, state: State, target_pose: Array) -> Array:
        soon = np.minimum(state["time"] + _MOMENT, state["duration"])
        now, then = (self._at(state, target_pose, time) for time in (state["time"], soon))
        velocity = twist_between(now, then, _MOMENT)
        return np.where(state["time"][:, np.newaxis] > 0.0, velocity, 0.0)

    def _seconds(self, begin: Array, end: Array) -> Array:
        """Return the shortest times between poses, shape (..., 7) -> (...)."""
        metres, radians = distance(begin, end)
        return np.maximum(metres / self.max_velocity, radians / self.max_angular_velocity)


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
        self._settings = EePathSettings(radius, clearance, min_height, max_height, foresight)

    def replan(self, state: State, ee_pose: Array, target_pose: Array, solids: Solids) -> State:
        """Return the state of motions around the solids as they stand now."""
        moved = distance(state["planned_target"], target_pose)[0]
        leads = (state["rate"] > 0.0) & (moved < _MOVED)
        current = leads, self._fraction(state, state["time"]), state["points"][..., :3]
        ends = ee_pose[:, :3], target_pose[:, :3]
        new, points = plan_ee_paths(self._settings, current, *ends, solids)
        velocity = self._velocity(state, target_pose)
        orientations = _slerped(ee_pose, target_pose)[..., 3:]
        points = np.concatenate([points, orientations], axis=2)
        begun = self._begin(state, (ee_pose, target_pose), points, velocity)
        return {
            key: np.where(new.reshape(-1, *[1] * (old.ndim - 1)), begun[key], old)
            for key, old in state.items()
        }


class WholeBody(Planned):
    """Motion around solids along which the base can follow, from rest to rest.

    A planner finds a motion of base and arm to the target without collisions, and the EE follows
    the EE path of this motion. If there is none, it moves as with `planned`, whose parameters are
    the same.
    """

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return straight motions.

        The keys are those of `planned`, and `follows`, shape (n,): 1 on a whole-body path, else 0.
        """
        state = super().start(ee_pose, target_pose, rngs)
        return {**state, "follows": np.zeros(len(target_pose))}

    def follow(
        self, state: State, ee_pose: Array, target_pose: Array, paths: Sequence[WholeBodyPath]
    ) -> tuple[State, Array]:
        """Return the state of motions along paths, and their waypoints, shape (n, 64, 3 + j)."""
        timed = zip(*map(self._timed, paths), strict=True)
        points, waypoints, least = (np.stack(each) for each in timed)
        velocity, poses = self._velocity(state, target_pose), (ee_pose, target_pose)
        begun = self._begin(state, poses, points, velocity, least)
        return {**begun, "follows": np.ones(len(paths))}, waypoints

    def robot_ahead(self, state: State, waypoints: Array, seconds: Array) -> Array:
        """Return base and joints some seconds ahead, (s,) -> (n, s, 3 + j), or NaN."""
        time = np.minimum(state["time"] + seconds[:, np.newaxis], state["duration"])
        return position_at(waypoints, self._fraction(state, time)).swapaxes(0, 1)

    def replan(self, state: State, ee_pose: Array, target_pose: Array, solids: Solids) -> State:
        """Return the state of motions around the solids; whole-body paths go on."""
        alone = np.flatnonzero(state["follows"] == 0.0)
        if not alone.size:
            return state
        rows = of_rows(state, alone), ee_pose[alone], target_pose[alone], solids.of(alone)
        return merged(state, alone, super().replan(*rows), len(ee_pose))

    def _timed(self, path: WholeBodyPath) -> tuple[Array, Array, Array]:
        """Return EE and robot at even times, (64, 7) and (64, 3 + j), and the duration, seconds."""
        seconds = np.maximum(self._seconds(path.ee[:-1], path.ee[1:]), path.seconds)
        time = np.concatenate([[0.0], np.cumsum(seconds + 1e-6)])
        at = np.linspace(0.0, time[-1], POINTS)
        columns = np.concatenate([path.ee[:, :3], continuous(path.ee[:, 3:]), path.robot], axis=1)
        even = interpolated_columns(at, time, columns)
        even[:, 3:7] /= np.linalg.norm(even[:, 3:7], axis=1, keepdims=True)
        return even[:, :7], even[:, 7:], time[-1]


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

    def start(self, ee_pose: Array, target_pose: Array, rngs: Rngs) -> State:
        """Return motions along random curves, a state as that of `SmoothPath`."""
        state = super().start(ee_pose, target_pose, rngs)
        knots, fine = np.linspace(0.0, 1.0, self._bends + 2), np.linspace(0.0, 1.0, 16 * POINTS)
        points = state["points"].copy()
        for row, rng in enumerate(rngs):
            begin, end = ee_pose[row, :3], target_pose[row, :3]
            bends = begin + knots[:, np.newaxis] * (end - begin)
            bends[1:-1] += self._spread * rng.uniform(-1.0, 1.0, (self._bends, 3))
            points[row, :, :3] = _even(CubicSpline(knots, bends)(fine))
        rest = np.zeros((len(rngs), 6))
        return self._begin(state, (ee_pose, target_pose), points, rest)


def _even(curve: Array) -> Array:
    """Return points at even steps along a finely sampled curve, shape (m, 3) -> (64, 3)."""
    length = np.concatenate([[0.0], np.cumsum(norm(np.diff(curve, axis=0)))])
    at = np.linspace(0.0, length[-1], POINTS)
    return interpolated_columns(at, length, curve)


def _slerped(begin: Array, end: Array) -> Array:
    fraction = np.linspace(0.0, 1.0, POINTS)[:, np.newaxis]
    twist = twist_between(begin, end, 1.0)[:, np.newaxis]
    poses = integrate(begin[:, np.newaxis], twist * fraction, 1.0)
    poses[..., 3:] = continuous(poses[..., 3:])
    return poses
