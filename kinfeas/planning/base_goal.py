"""Motions of base and arm to EE goals among solids."""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from kinfeas.core.kernels import kernel
from kinfeas.core.motion import WholeBodyPath
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import (
    Array,
    compose,
    interpolated_columns,
    planar_pose,
    relative,
    yaw,
)
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.self_collision import make_collision_scratch, place_shapes
from kinfeas.kinematics.solids import collides
from kinfeas.planning.base_lattice import LATTICE, Query, driving_costs, lattice_moves, search_base
from kinfeas.planning.placement import Postures, at_goals
from kinfeas.robots.robot import joint_displacement

CHECKED_AHEAD = np.arange(1.0, 7.0)  # seconds after which a motion among moving solids is checked


class Attempt(NamedTuple):
    """One attempt to find a motion; later ones ask for less."""

    margin: float  # distance of the base path from solids, metres; may be negative
    reach: float  # distance from start and goal within which the arm is not at rest, metres
    rounding: float  # standard deviation of the smoothing of the base path, metres
    small: bool  # whether the arm rests where it takes least room, not nearest to start and goal


@dataclass(frozen=True)
class BaseGoalSettings:
    """Settings of the search for motions to goals."""

    attempts: tuple[Attempt, ...] = (
        Attempt(0.07, 0.8, 0.25, small=False),
        Attempt(0.03, 0.8, 0.25, small=True),
        Attempt(0.0, np.inf, 0.1, small=True),
        Attempt(-0.03, np.inf, 0.1, small=True),
    )
    used: float = 0.5  # cost added to a base pose at the goal after its attempt failed, metres
    margin: float = 0.02  # distance from solids on the motion, metres
    early: float = 1.0  # time by which the robot may be early or late where solids move, seconds
    proposals: tuple[int, ...] = (0, 64, 256, 1024, 2048)  # base poses tried at the ends of stages
    goal_margins: tuple[float, ...] = (0.08, 0.08, 0.03, 0.0)  # their distance from solids, metres
    enough: int = 8  # base poses that end the stages; at most twice as many are compared
    border: float = 3.0  # width of the floor around start and goal that is searched, metres
    step: float = 0.05  # distance between the poses of a motion, metres
    unfold: tuple[float, ...] = (3.0, 1.2, 0.3)  # lengths of path to unfold the arm, tried in order
    rest_reach: tuple[float, float] = (0.4, 0.75)  # EE at rest: distance from the base, metres
    rest_bearing: float = 0.6  # largest bearing of the EE at rest, radians
    rest_height: tuple[float, float] = (0.5, 1.3)  # height of the EE at rest, metres
    rests: int = 512  # largest number of arm configurations at rest
    table: float = 0.9  # height above which few solids reach, metres
    above: float = 0.6  # fraction of the room of an arm above this height that counts
    stray: tuple[float, float, float] = (0.08, 0.08, 0.15)  # deviation of a base: x, y, yaw; m, rad
    worse: float = 0.05  # fraction of deviating bases that a rest may compensate less than the best
    speed: float = 0.7  # fraction of the velocity limits of base and arm that a motion uses
    joint_cost: float = 0.1  # cost of a radian of arm motion where goals are compared, metres


class BaseGoalPlanner:
    """Finds motions of one robot to EE goals among solids.

    A* finds a path of the base, with the arm at rest, to one of the base poses from which IK
    reaches the goal. The arm moves to its rest configuration on the first metres and from it to the
    goal on the last metres. Moving solids count where they will be when the robot comes by.
    """

    def __init__(
        self, solver: IkSolver, time_scale: float = 1.0, settings: BaseGoalSettings | None = None
    ) -> None:
        """Plan motions that are carried out at a fraction `time_scale` of their speed."""
        self.robot = robot = solver.robot
        self.settings = settings = settings or BaseGoalSettings()
        self.solver = IkSolver(robot, at_goals(robot, solver.options))
        self._postures = Postures(self.solver)
        self._rests = _rests(self._postures, settings)
        room = _room(self.solver.collision, self._rests, settings.table, settings.above)
        self._small = int(room.argmin())
        self._moves = lattice_moves(omnidirectional=robot.base.drive == "omnidirectional")
        limits = np.array([robot.base.max_velocity, robot.base.max_rotation])
        self._time_scale, self._speed = time_scale, settings.speed * time_scale * limits

    def plan(
        self, base_pose: Array, joints: Array, goal: Array, solids: Solids
    ) -> WholeBodyPath | None:
        """Return a motion to a goal, or None if none is found.

        In narrow places, some of its poses may touch solids.

        Args:
            base_pose: World pose of the base now, shape (7,).
            joints: Arm joints now, shape (j,).
            goal: World pose of the EE, shape (7,).
            solids: In the world, one row.
        """
        settings = self.settings
        solids = solids.swept(-settings.early, settings.early)
        arrival = np.hypot(*(goal - base_pose)[:2]) / self._speed[0]
        ends, arms = self._ends(goal, _later(solids, np.array([float(arrival)])))
        if not len(ends):
            return None
        from_start = np.abs(self._displacement(joints, self._rests)).max(axis=1)
        to_ends = np.abs(self._displacement(self._rests[:, np.newaxis], arms)).max(axis=2)
        near = int((from_start + to_ends.min(axis=1)).argmin())
        start = np.array([*base_pose[:2], float(yaw(base_pose))])
        used, best, fewest = np.zeros(len(ends)), None, np.inf
        for attempt in settings.attempts:
            rest = self._small if attempt.small else near
            arm = self._rests[rest], attempt.reach
            cost = settings.joint_cost * to_ends[rest] + used
            corners, end = self._drive(start, ends, cost, arm, solids.wider(attempt.margin))
            if end < 0:
                continue
            corners = np.vstack([start, corners, ends[end]])
            base = _smooth(corners, attempt.rounding, settings.step)
            path, blocked = self._with_arm(base, (joints, arm[0], arms[end]), solids)
            if blocked < fewest:
                best, fewest = path, blocked
            if not blocked:
                break
            used[end] += settings.used
        if best is not None:
            best.ee[-1] = goal
        return best

    def free(self, robot: Array, solids: Solids) -> bool:
        """Return whether the robot will touch no solid on its path.

        Args:
            robot: x, y and yaw of the base and arm joints after `CHECKED_AHEAD` seconds, shape
                (s, 3 + j); NaN without a path.
            solids: In the world, one row.
        """
        if np.isnan(robot).any():
            return False
        then = _later(solids.wider(self.settings.margin), CHECKED_AHEAD)
        base, arm = planar_pose(*robot[:, :3].T), np.ascontiguousarray(robot[:, 3:])
        return not collides(self.solver.collision, arm, base, then).any()

    def _ends(self, goal: Array, solids: Solids) -> tuple[Array, Array]:
        """Return base poses x, y, yaw, (p, 3), from which arms, (p, j), reach a goal."""
        settings, stages = self.settings, self.settings.proposals
        ends, arms = np.empty((0, 3)), np.empty((0, len(self.robot.arm)))
        for first, last, margin in zip(stages, stages[1:], settings.goal_margins, strict=False):
            base, joints = self._postures.reaching(goal, (first, last), solids.wider(margin))
            ends = np.concatenate([ends, np.column_stack([base[:, :2], yaw(base)])])
            arms = np.concatenate([arms, joints])
            if len(ends) >= settings.enough:
                break
        return ends[: 2 * settings.enough], arms[: 2 * settings.enough]

    def _drive(
        self, start: Array, ends: Array, cost: Array, arm: tuple[Array, float], solids: Solids
    ) -> tuple[Array, int]:
        """Return base poses on the path to the cheapest end, (k, 3), and the end's index, or -1.

        `cost` is that of arriving at each end, shape (p,), metres; `arm` has the joints at rest and
        the `reach` of the attempt.
        """
        corners, border = np.vstack([start[:2], ends[:, :2]]), self.settings.border
        low, high = corners.min(axis=0) - border, corners.max(axis=0) + border
        rows = solids.pose[0], solids.size[0], solids.cylinder[0], solids.velocity[0]
        query = Query(
            model=self.solver.collision, rest=arm[0], reach=arm[1],
            start=start, goals=ends, goal_costs=cost, solids=rows, origin=low,
            driving=driving_costs(solids, low, high, LATTICE.cell, self._postures.footprint),
            moves=self._moves, speed=self._speed,
        )  # fmt: skip
        path, end = search_base(query)
        return path, int(end)

    def _with_arm(
        self, base: Array, arms: tuple[Array, Array, Array], solids: Solids
    ) -> tuple[WholeBodyPath, int]:
        """Return the motion along base poses, (k, 3), and the number of poses that are not free.

        Poses that touch solids or are not admissible are not free. `arms` are the configurations
        at the start, at rest and at the end.
        """
        s, (begin, rest, end) = _path_lengths(base), arms
        model, pose = self.solver.collision, planar_pose(*base.T)
        among = _later(solids.wider(self.settings.margin), self._times(base))

        def blocked(arm: Array, rows: NDArray[np.bool_]) -> int:
            touches = collides(model, arm, pose[rows], among.of(np.flatnonzero(rows))).any(axis=1)
            return int(np.sum(~self.solver.admissible(arm) | touches))

        first, total = s <= s[-1] / 2.0, 0
        arm = np.empty((len(base), len(begin)))
        for half, other, away in ((first, begin, s), (~first, end, s[-1] - s)):
            fewest = len(base) + 1
            for unfold in self.settings.unfold:
                fraction = 1.0 - _eased(away[half] / min(unfold, s[-1] / 2.0))
                unfolded = rest + fraction[:, np.newaxis] * self._displacement(rest, other)
                if (count := blocked(unfolded, half)) < fewest:
                    fewest, arm[half] = count, unfolded
                if not count:
                    break
            total += fewest
        if total:
            direct = begin + _eased(s / s[-1])[:, np.newaxis] * self._displacement(begin, end)
            if (count := blocked(direct, np.ones_like(first))) < total:
                total, arm = count, direct
        return self._path(base, pose, arm), total

    def _path(self, base: Array, pose: Array, arm: Array) -> WholeBodyPath:
        joints = np.abs(self._displacement(arm[:-1], arm[1:]))
        joints /= self.settings.speed * self.robot.max_joint_velocity
        driving = self._time_scale * np.diff(self._times(base))
        seconds = np.maximum(driving, joints.max(axis=1))
        ee = compose(pose, forward(self.solver.chain, arm))
        return WholeBodyPath(ee, np.concatenate([base, arm], axis=1), seconds)

    def _times(self, base: Array) -> Array:
        """Return when the base is at each of its poses, (k, 3) -> (k,), seconds."""
        step = np.abs(np.diff(base, axis=0))
        driving, turning = np.hypot(step[:, 0], step[:, 1]), step[:, 2]
        seconds = np.maximum(driving / self._speed[0], turning / self._speed[1])
        return np.concatenate([[0.0], np.cumsum(seconds)])

    def _displacement(self, begin: Array, end: Array) -> Array:
        return joint_displacement(self.robot, begin, end)


def _rests(postures: Postures, settings: BaseGoalSettings) -> Array:
    """Return rest configurations, with the EE ahead of the base, most centred first, (r, j).

    They are those that can best keep their EE pose while the base deviates from its path.
    """
    robot, joints, ee = postures.solver.robot, postures.joints, postures.ee_pose
    reach, bearing = np.hypot(ee[:, 0], ee[:, 1]), np.arctan2(ee[:, 1], ee[:, 0])
    fits = np.abs(bearing) < settings.rest_bearing
    for value, (least, most) in ((reach, settings.rest_reach), (ee[:, 2], settings.rest_height)):
        fits &= (value > least) & (value < most)
    lower, upper = robot.finite_joint_limits
    off = np.abs(joints - (lower + upper) / 2.0) / np.maximum((upper - lower) / 2.0, 1e-9)
    off[:, ~np.isfinite(np.subtract(*robot.joint_limits))] = 0.0
    # Where no configuration has the EE there, the most centred one is taken.
    order = np.lexsort((off.max(axis=1), ~fits))[: min(settings.rests, max(int(fits.sum()), 1))]
    reached = _reached(postures.solver, joints[order], ee[order], settings.stray)
    return joints[order[reached >= reached.max() - settings.worse]]


def _reached(solver: IkSolver, joints: Array, ee: Array, stray: tuple[float, ...]) -> Array:
    """Return the fraction of deviating bases from which each arm keeps its EE pose, shape (r,).

    Joints have shape (r, j), EE poses in the frame of the base that does not deviate (r, 7).
    """
    strayed = np.array(list(product((-1.0, 0.0, 1.0), repeat=3))) * stray
    targets = relative(ee[:, np.newaxis], planar_pose(*strayed.T)).reshape(-1, 7)
    arm = solver.local().solve(targets, joints.repeat(len(strayed), axis=0))
    return arm.feasible.reshape(len(ee), -1).mean(axis=1)


@kernel
def _room(model, joints, table, above):
    """Return how far arms extend from the base's origin, seen from above, (n, j) -> (n,), metres.

    Of shapes above the height `table`, the fraction `above` of the distance counts.
    """
    scratch, room = make_collision_scratch(model), np.zeros(len(joints))
    for i in range(len(joints)):
        place_shapes(model, joints[i], scratch)
        for s in range(len(model.body)):
            if model.body[s] >= 0:
                x, y, z = scratch.position[s]
                far = math.sqrt(x * x + y * y) + model.radius[s]
                room[i] = max(room[i], far if z - model.radius[s] < table else above * far)
    return room


def _path_lengths(base: Array) -> Array:
    """Return the length of a base path up to each pose, with rotations, (k, 3) -> (k,), metres."""
    x, y, angle = np.abs(np.diff(base, axis=0)).T
    return np.cumsum([0.0, *(np.maximum(np.hypot(x, y), LATTICE.lever * angle) + 1e-9)])


def _smooth(corners: Array, deviation: float, step: float) -> Array:
    """Return base poses at even steps along a path with rounded corners, (m, 3) -> (k, 3)."""
    corners = np.column_stack([corners[:, :2], np.unwrap(corners[:, 2])])
    s = _path_lengths(corners)
    count = max(int(s[-1] / step), 8) + 1
    even = np.linspace(0.0, s[-1], count)
    path = interpolated_columns(even, s, corners)
    sigma = min(deviation, s[-1] / 6.0) / even[1]
    mirrored = [2.0 * path[0] - path[:0:-1], path, 2.0 * path[-1] - path[-2::-1]]
    smooth = gaussian_filter1d(np.concatenate(mirrored), sigma, axis=0)
    smooth = np.asarray(smooth[count - 1 : 2 * count - 1])
    smooth[[0, -1]] = path[[0, -1]]
    return smooth


def _eased(fraction: Array) -> Array:
    """Return the fraction after smooth acceleration and deceleration, 0 and 1 beyond [0, 1]."""
    u = np.clip(fraction, 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def _later(solids: Solids, seconds: Array) -> Solids:
    """Return m rows of the first row's solids after m times, s; they stop after `foresight`."""
    later = solids.repeated(len(seconds))
    pose = later.pose.copy()
    ahead = np.minimum(seconds, LATTICE.foresight)[:, np.newaxis, np.newaxis]
    pose[..., :2] += later.velocity * ahead
    return replace(later, pose=pose)
