"""Motions of base and arm to EE goals among solids."""

import math
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from kinfeas.core.motion import WholeBodyPath
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, compose, planar_pose, relative, yaw
from kinfeas.kinematics.base_search import (
    CELL,
    FORESIGHT,
    LEVER,
    driving_costs,
    lattice_moves,
    search_base,
)
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver
from kinfeas.kinematics.kernels import kernel
from kinfeas.kinematics.reachability import Postures, at_goals
from kinfeas.kinematics.self_collision import make_collision_scratch, place_shapes
from kinfeas.kinematics.solids import base_collides, collides, in_base
from kinfeas.robots.robot import joint_displacement

CHECKED_AHEAD = np.arange(1.0, 7.0)
"""Seconds after which a motion among moving solids is checked."""

_EARLY = 1.0
"""Seconds by which the robot may be earlier or later than planned where solids move."""


class _Try(NamedTuple):
    """One try to find a motion; later tries ask for less.

    Attributes:
        margin: Distance of the base path from solids, metres; negative lets the lattice touch them.
        reach: Distance from start and goal within which the arm is not at rest, metres.
        rounding: Standard deviation of the smoothing of the base path, metres.
        small: Whether the arm takes least room at rest, or else is nearest to start and goal.
    """

    margin: float
    reach: float
    rounding: float
    small: bool


_TRIES = (
    _Try(0.07, 0.8, 0.25, small=False),
    _Try(0.03, 0.8, 0.25, small=True),
    _Try(0.0, np.inf, 0.1, small=True),
    _Try(-0.03, np.inf, 0.1, small=True),
)

_USED = 0.5
"""What a place costs more in later tries, metres."""

_MARGIN = 0.02
"""Distance from solids on the motion, metres."""

_PROPOSALS, _AT_GOAL, _ENOUGH = (0, 64, 256, 1024, 2048), (0.08, 0.08, 0.03, 0.0), 8
"""Stages of base poses that are proposed for a goal, distances from solids there by stage, metres,
and how many base poses suffice."""

_BORDER = 3.0
"""Width of the floor around start and goal that is searched, metres."""

_STEP, _UNFOLD = 0.05, (3.0, 1.2, 0.3)
"""Distance between the poses of a motion, and ways of the base on which the arm leaves or reaches
its rest, metres."""

_AHEAD, _ASIDE, _HEIGHT = (0.4, 0.75), 0.6, (0.5, 1.3)
"""Where the EE of an arm at rest is: distances from the base's origin and heights, metres, and the
largest bearing, radians."""

_RESTS, _TABLE = 512, 0.9
"""Arm configurations at rest at most, and height above which few solids reach, metres."""

_STRAY = (0.08, 0.08, 0.15)
"""How far a base may stray from its path, metres and radians."""

_WORSE = 0.05
"""By how much the share of strayed bases from which an arm at rest reaches its EE pose may be below
that of the best arm."""

_SPEED = 0.7
"""Share of the velocity limits of base and arm that a motion uses."""

_JOINT_COST = 0.1
"""Metres that a radian of the arm costs where goals are compared."""


class WholeBodyPlanner:
    """Finds motions of one robot to EE goals among solids.

    A* finds the way of the base, with the arm at rest, to base poses from which IK reaches the
    goal. The arm moves to its rest on the first metres and from there to the goal on the last ones.
    Solids that move are where they will be when the robot comes by.
    """

    def __init__(self, solver: IkSolver, time_scale: float = 1.0) -> None:
        """Choose the arm configurations in which the robot drives.

        Motions are carried out at a share `time_scale` of their speed.
        """
        self.robot = robot = solver.robot
        self.solver = IkSolver(robot, at_goals(robot, solver.options))
        self._postures = Postures(self.solver)
        self._rests = _rests(self._postures)
        self._small = int(_room(self.solver.collision, self._rests).argmin())
        self._moves = lattice_moves(omnidirectional=robot.base.drive == "omnidirectional")
        limits = np.array([robot.base.max_velocity, robot.base.max_rotation])
        self._time_scale, self._speed = time_scale, _SPEED * time_scale * limits

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
        solids = _blurred(solids)
        places, arms = self._places(goal, self._at_arrival(base_pose, goal, solids))
        if not len(places):
            return None
        leave = np.abs(self._way(joints, self._rests)).max(axis=1)
        reach = np.abs(self._way(self._rests[:, np.newaxis], arms)).max(axis=2)
        near = int((leave + reach.min(axis=1)).argmin())
        start = np.array([*base_pose[:2], float(yaw(base_pose))])
        used, found, fewest = np.zeros(len(places)), None, np.inf
        for one in _TRIES:
            rest = self._small if one.small else near
            arm = self._rests[rest], one.reach
            cost = _JOINT_COST * reach[rest] + used
            way, place = self._drive(start, places, cost, arm, solids.wider(one.margin))
            if place < 0:
                continue
            base = _smooth(np.vstack([start, way, places[place]]), one.rounding)
            path, touching = self._with_arm(base, (joints, arm[0], arms[place]), solids)
            if touching < fewest:
                found, fewest = path, touching
            if not touching:
                break
            used[place] += _USED
        if found is not None:
            found.ee[-1] = goal
        return found

    def free(self, robot: Array, solids: Solids) -> bool:
        """Return whether the robot will touch no solid on its way.

        Args:
            robot: x, y and yaw of the base and arm joints after `CHECKED_AHEAD` seconds, shape
                (s, 3 + j); NaN without a way.
            solids: In the world, one row.
        """
        if np.isnan(robot).any():
            return False
        then = _later(solids.wider(_MARGIN), CHECKED_AHEAD)
        base, arm = planar_pose(*robot[:, :3].T), np.ascontiguousarray(robot[:, 3:])
        return not collides(self.solver.collision, arm, base, then).any()

    def _at_arrival(self, base_pose: Array, goal: Array, solids: Solids) -> Solids:
        """Return the solids as they will stand when a robot has driven straight to its goal."""
        seconds = float(np.hypot(*(goal - base_pose)[:2])) / self._speed[0]
        return _later(solids, np.array([seconds]))

    def _places(self, goal: Array, solids: Solids) -> tuple[Array, Array]:
        """Return base poses x, y, yaw, (p, 3), and arms, (p, j), that reach a goal."""
        places, arms = np.empty((0, 3)), np.empty((0, len(self.robot.arm)))
        for first, last, margin in zip(_PROPOSALS, _PROPOSALS[1:], _AT_GOAL, strict=False):
            wide = solids.wider(margin)
            base, joints = self._postures.around(goal, first, last)
            among = wide.repeated(len(base))
            rows = np.flatnonzero(~base_collides(self.solver.collision, base, among))
            base, joints = base[rows], joints[rows]
            found = self.solver.solve(
                relative(np.broadcast_to(goal, base.shape), base),
                joints,
                solids=in_base(among.of(rows), base),
            )
            rows = np.flatnonzero(found.feasible)
            places = np.concatenate([places, np.column_stack([base[rows, :2], yaw(base[rows])])])
            arms = np.concatenate([arms, found.joint_positions[rows]])
            if len(places) >= _ENOUGH:
                break
        return places[: 2 * _ENOUGH], arms[: 2 * _ENOUGH]

    def _drive(
        self, start: Array, places: Array, cost: Array, arm: tuple[Array, float], solids: Solids
    ) -> tuple[Array, int]:
        """Return base poses on the way to the cheapest place, (k, 3), and its number, or -1.

        `arm` has the joints at rest and the `reach` of the try, `cost` is of the places, (p,).
        """
        known = np.concatenate([start[np.newaxis, :2], places[:, :2]])
        low, high = known.min(axis=0) - _BORDER, known.max(axis=0) + _BORDER
        shape = np.ceil((high - low) / CELL).astype(np.int64) + 1
        rows = solids.pose[0], solids.size[0], solids.cylinder[0], solids.velocity[0]
        disc = np.array(self._postures.footprint)
        grid = low, driving_costs(low, shape, rows, disc)
        model = self.solver.collision
        how = self._moves, self._speed
        way, place = search_base(model, *arm, start, places, cost, rows, grid, *how)
        return way, int(place)

    def _with_arm(
        self, base: Array, arms: tuple[Array, Array, Array], solids: Solids
    ) -> tuple[WholeBodyPath, int]:
        """Return the motion along base poses, (k, 3), and the number of poses that are not free.

        Those touch something or are not admissible.

        `arms` are the configurations at the start, at rest and at the end.
        """
        way = np.linalg.norm(np.diff(base[:, :2], axis=0), axis=1)
        length = np.maximum(way, LEVER * np.abs(np.diff(base[:, 2]))) + 1e-9
        s = np.concatenate([[0.0], np.cumsum(length)])
        begin, rest, end = arms
        model, pose = self.solver.collision, planar_pose(*base.T)
        among = _later(solids.wider(_MARGIN), self._times(base))

        def touching(arm: Array, rows: NDArray[np.bool_]) -> int:
            touches = collides(model, arm, pose[rows], among.of(np.flatnonzero(rows))).any(axis=1)
            return int(np.sum(~self.solver.admissible(arm) | touches))

        first, total = s <= s[-1] / 2.0, 0
        arm = np.empty((len(base), len(begin)))
        for half, other, away in ((first, begin, s), (~first, end, s[-1] - s)):
            fewest = len(base) + 1
            for unfold in _UNFOLD:
                share = 1.0 - _eased(away[half] / min(unfold, s[-1] / 2.0))
                tried = rest + share[:, np.newaxis] * self._way(rest, other)
                if (count := touching(tried, half)) < fewest:
                    fewest, arm[half] = count, tried
                if not count:
                    break
            total += fewest
        if total:
            direct = begin + _eased(s / s[-1])[:, np.newaxis] * self._way(begin, end)
            if (count := touching(direct, np.ones_like(first))) < total:
                total, arm = count, direct
        return self._path(base, pose, arm), total

    def _path(self, base: Array, pose: Array, arm: Array) -> WholeBodyPath:
        """Return the motion of base and arm, shapes (k, 3), (k, 7) and (k, j), with its times."""
        joints = np.abs(self._way(arm[:-1], arm[1:])) / (_SPEED * self.robot.max_joint_velocity)
        driving = self._time_scale * np.diff(self._times(base))
        seconds = np.maximum(driving, joints.max(axis=1))
        ee = compose(pose, forward(self.solver.chain, arm))
        return WholeBodyPath(ee, np.concatenate([base, arm], axis=1), seconds)

    def _times(self, base: Array) -> Array:
        """Return when the base is at each of its poses, (k, 3) -> (k,), seconds."""
        way = np.abs(np.diff(base, axis=0))
        driving, turning = np.hypot(way[:, 0], way[:, 1]), way[:, 2]
        seconds = np.maximum(driving / self._speed[0], turning / self._speed[1])
        return np.concatenate([[0.0], np.cumsum(seconds)])

    def _way(self, begin: Array, end: Array) -> Array:
        return joint_displacement(self.robot, begin, end)


def _rests(postures: Postures) -> Array:
    """Return arm configurations with the EE ahead, those with centred joints first, (r, j).

    From them, an arm also reaches its EE pose where its base strays.
    """
    robot, joints, ee = postures.solver.robot, postures.joints, postures.ee_pose
    reach, bearing = np.hypot(ee[:, 0], ee[:, 1]), np.arctan2(ee[:, 1], ee[:, 0])
    fits = (reach > _AHEAD[0]) & (reach < _AHEAD[1]) & (np.abs(bearing) < _ASIDE)
    fits &= (ee[:, 2] > _HEIGHT[0]) & (ee[:, 2] < _HEIGHT[1])
    lower, upper = robot.finite_joint_limits
    off = np.abs(joints - (lower + upper) / 2.0) / np.maximum((upper - lower) / 2.0, 1e-9)
    off[:, ~np.isfinite(np.subtract(*robot.joint_limits))] = 0.0
    # A robot whose EE never comes there drives with the most centred arm.
    order = np.lexsort((off.max(axis=1), ~fits))[: min(_RESTS, max(int(fits.sum()), 1))]
    reached = _reached(postures.solver, joints[order], ee[order])
    return joints[order[reached >= reached.max() - _WORSE]]


def _reached(solver: IkSolver, joints: Array, ee: Array) -> Array:
    """Return from which share of strayed bases arms (r, j) reach their EE, (r, 7) -> (r,)."""
    strayed = np.array(list(product((-1.0, 0.0, 1.0), repeat=3))) * _STRAY
    targets = relative(ee[:, np.newaxis], planar_pose(*strayed.T)).reshape(-1, 7)
    near = IkSolver(solver.robot, replace(solver.options, restarts=0))
    found = near.solve(targets, joints.repeat(len(strayed), axis=0))
    share: Array = found.feasible.reshape(len(ee), -1).mean(axis=1)
    return share


@kernel
def _room(model, joints):
    """Return how far arms reach from the base's origin, seen from above, (n, j) -> (n,), metres.

    Of what is above tables, 0.6 times the distance counts.
    """
    scratch, room = make_collision_scratch(model), np.zeros(len(joints))
    for i in range(len(joints)):
        place_shapes(model, joints[i], scratch)
        for s in range(len(model.body)):
            if model.body[s] >= 0:
                x, y, z = scratch.position[s]
                far = math.sqrt(x * x + y * y) + model.radius[s]
                room[i] = max(room[i], far if z - model.radius[s] < _TABLE else 0.6 * far)
    return room


def _smooth(corners: Array, deviation: float) -> Array:
    """Return base poses at even steps along corners, rounded, shape (m, 3) -> (k, 3)."""
    corners = np.column_stack([corners[:, :2], np.unwrap(corners[:, 2])])
    steps = np.diff(corners, axis=0)
    length = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), LEVER * np.abs(steps[:, 2])) + 1e-9
    s = np.concatenate([[0.0], np.cumsum(length)])
    count = max(int(s[-1] / _STEP), 8) + 1
    even = np.linspace(0.0, s[-1], count)
    path = np.stack([np.interp(even, s, column) for column in corners.T], axis=1)
    sigma = min(deviation, s[-1] / 6.0) / even[1]
    mirrored = [2.0 * path[0] - path[:0:-1], path, 2.0 * path[-1] - path[-2::-1]]
    smooth = gaussian_filter1d(np.concatenate(mirrored), sigma, axis=0)
    smooth = np.asarray(smooth[count - 1 : 2 * count - 1])
    smooth[[0, -1]] = path[[0, -1]]
    return smooth


def _eased(share: Array) -> Array:
    """Return the share after smooth acceleration and deceleration, 0 and 1 beyond [0, 1]."""
    u = np.clip(share, 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def _later(solids: Solids, seconds: Array) -> Solids:
    """Return one row of solids as they will stand after some seconds, m rows."""
    later = solids.repeated(len(seconds))
    pose = later.pose.copy()
    pose[..., :2] += later.velocity * np.minimum(seconds, FORESIGHT)[:, np.newaxis, np.newaxis]
    return replace(later, pose=pose)


def _blurred(solids: Solids) -> Solids:
    """Return solids with the room in which they are within `_EARLY`."""
    x, y = np.moveaxis(_EARLY * solids.velocity, -1, 0)
    cosine, sine = np.cos(solids.pose[..., 2]), np.sin(solids.pose[..., 2])
    size = solids.size.copy()
    size[..., 0] += np.where(solids.cylinder, np.hypot(x, y), np.abs(cosine * x + sine * y))
    size[..., 1] += np.where(solids.cylinder, np.hypot(x, y), np.abs(cosine * y - sine * x))
    return replace(solids, size=size)
