"""Base poses for EE poses, with margins, or the reason for which there is none."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array, relative, rotation
from kinfeas.kinematics.forward import jacobian
from kinfeas.kinematics.ik import POSE_DIMENSIONS, IkOptions, IkSolver
from kinfeas.kinematics.solids import collides, in_base
from kinfeas.planning.placement import Postures, at_goals
from kinfeas.robots.robot import Robot

LIMITS = {  # reasons for which a pose is out of reach, of which the first that applies is reported
    "floor": "below the floor",
    "height": "above or below the heights of the EE",
    "orientation": "no arm configuration has this height and tilt",
    "self-collision": "arm configurations touch the robot or the floor",
    "torque": "motors cannot hold arm configurations",
    "solids": "solids are in the way of base or arm",
    "path": "solids block the base's way from the start",
    "motion": "no base pose reaches all poses; the robot has to move",
}


@dataclass(frozen=True)
class ReachSettings:
    """Settings of the search for base poses and their margins."""

    first: tuple[int, ...] = (64, 160, 512)  # base poses tried by the end of each stage of local IK
    stages: tuple[int, ...] = (8, 32, 128, 512, 1024)  # the same with IK restarts, if none is found
    compared: int = 64  # base poses of which the best are returned
    unlimited: int = 1024  # base poses tried with a limit lifted, to find the one that applies
    together: int = 512  # base poses that are tried for several poses, selected from
    proposed: int = 4096  # base poses for single ones
    clearances: tuple[float, ...] = (0.02, 0.05, 0.1)  # distances from solids, metres


_SETTINGS = ReachSettings()


@dataclass(frozen=True)
class Placement:
    """The m base poses that reach an EE pose, or each of n EE poses; the best first."""

    base_pose: Array  # world poses of the base, shape (m, 7)
    joint_positions: Array  # arm joints at each, shape (m, j), or (m, n, j) for several EE poses
    joint_margin: Array  # distance to the nearest joint limit as a fraction of its range, (m,)
    # distance from solids that base and arm keep, the largest of 0, 0.02, 0.05 and 0.1 m, (m,)
    clearance: Array
    manipulability: Array  # Yoshikawa's measure as a fraction of the robot's largest, shape (m,)
    limit: str = ""  # reason for which no base pose was found, one of `LIMITS`; empty if one was
    solids: tuple[int | str, ...] = ()  # solids in the way, by their places or names
    heights: tuple[float, float] = (0.0, 0.0)  # of the EE, if `limit` is `height`, metres

    def __repr__(self) -> str:
        best = self.margin.max(initial=0.0)
        return f"Placement({self.reason or f'{len(self.base_pose)} base poses, {best:.2f} margin'})"

    @property
    def reachable(self) -> bool:
        """Whether there is a base pose."""
        return len(self.base_pose) > 0

    @property
    def margin(self) -> Array:
        """Distance from infeasible arms and collisions, 0-1, by which base poses are sorted, (m,).

        It is the least of twice `joint_margin`, `manipulability` and `clearance` divided by 0.1 m.
        """
        near = self.clearance / _SETTINGS.clearances[-1]
        return np.minimum(np.minimum(2.0 * self.joint_margin, self.manipulability), near)

    @property
    def reason(self) -> str:
        """The limit as a text; empty if there is a base pose."""
        if self.limit == "height":
            return f"{LIMITS['height']}, {self.heights[0]:.2f} to {self.heights[1]:.2f} m"
        if self.limit != "solids" or not self.solids:
            return LIMITS.get(self.limit, "")
        return f"in the way of base or arm: {', '.join(map(str, self.solids))}"

    def named(self, names: Sequence[str]) -> "Placement":
        """Return the placement with solids by name, where `names` are those of all places."""
        return replace(self, solids=tuple(dict.fromkeys(names[int(k)] for k in self.solids)))

    def of(self, rows: NDArray[np.intp]) -> "Placement":
        """Return some of the base poses."""
        margins = self.joint_margin[rows], self.clearance[rows], self.manipulability[rows]
        return Placement(self.base_pose[rows], self.joint_positions[rows], *margins)


class BasePlacer:
    """Finds base poses of one robot for EE poses; each answer depends on its arguments alone."""

    def __init__(self, robot: Robot, ik: IkOptions | None = None) -> None:
        self._postures = Postures(IkSolver(robot, at_goals(robot, ik or IkOptions())))
        self.solver = self._postures.solver
        self._best = float(_manipulability(self.solver, self._postures.joints).max(initial=1e-9))

    def place(
        self, goal: Array, solids: Solids | None = None, start: Array | None = None, count: int = 8
    ) -> Placement:
        """Return up to `count` base poses from which the arm reaches an EE pose.

        They are the best of at least 64, if the stages of `ReachSettings` find as many.

        Args:
            goal: World pose of the EE, shape (7,).
            solids: In the world, one row.
            start: World pose of the base, shape (7,), from which a disc within the base must be
                able to drive to the base poses.
            count: Largest number of base poses.
        """
        most = max(count, _SETTINGS.compared)
        base, joints = self._search(goal, _SETTINGS.stages, solids, start, most)
        if len(base):
            return self._rated(base, joints[:, np.newaxis], solids, count, single=True)
        limit = self.limit(goal, solids, start)
        nearest = self._in_the_way(goal, solids) if limit == "solids" and solids else ()
        return replace(self._none(limit), solids=nearest)

    def region(
        self, goal: Array, solids: Solids | None = None, start: Array | None = None
    ) -> Placement:
        """Return all base poses of the last stage, for a map; arguments are those of `place`."""
        last = _SETTINGS.stages[-1]
        base, joints = self._postures.reaching(goal, (0, last), solids, start, restarts=False)
        return self._rated(base, joints[:, np.newaxis], solids, last, single=True)

    def place_for_all(
        self, goals: Array, solids: Solids | None = None, start: Array | None = None, count: int = 8
    ) -> Placement:
        """Return base poses from each of which the arm reaches all EE poses, shape (n, 7).

        Other arguments are those of `place`. If one EE pose is out of reach by itself, the
        result is that of `place` for this pose.
        """
        most = max(_SETTINGS.proposed // len(goals), 1)
        for found in (1, most):
            candidates = [
                self._search(goal, _SETTINGS.stages, solids, start, found)[0] for goal in goals
            ]
            for goal, bases in zip(goals, candidates, strict=True):
                if not len(bases):
                    return self.place(goal, solids, start)
            base = _nearest_first([bases[:most] for bases in candidates])[: _SETTINGS.together]
            joints = np.empty((len(base), 0, len(self.solver.robot.arm)))
            seed = np.tile(self.solver.robot.home["home"], (len(base), 1))
            for goal in goals:
                among = None if solids is None else in_base(solids.repeated(len(base)), base)
                arm = self.solver.solve(relative(goal, base), seed, solids=among)
                seed = arm.joint_positions[arm.feasible]
                base = base[arm.feasible]
                joints = np.concatenate([joints[arm.feasible], seed[:, np.newaxis]], axis=1)
            if len(base):
                return self._rated(base, joints, solids, count)
        return self._none("motion")

    def limit(self, goal: Array, solids: Solids | None = None, start: Array | None = None) -> str:
        """Return the reason for which an EE pose is out of reach, one of `LIMITS`.

        It is the first limit that keeps the robot from the pose if those after it are lifted.
        """
        if goal[2] < 0.0:
            return "floor"
        stages, (lowest, highest) = (_SETTINGS.unlimited,), self._heights
        beyond = not lowest <= goal[2] <= highest
        for name, postures in self._without:
            if not len(self._search(goal, stages, postures=postures)[0]):
                return "height" if name == "orientation" and beyond else name
        if solids is None or not len(self._search(goal, stages)[0]):
            return "torque" if self.solver.gravity.limited else "self-collision"
        blocked = start is not None and len(self._search(goal, stages, solids)[0]) > 0
        return "path" if blocked else "solids"

    def touching(self, base: Array, joints: Array, solids: Solids) -> NDArray[np.bool_]:
        """Return which of k solids each of m robots touches, shape (m, k)."""
        singles = (solids.only(np.array([k])).repeated(len(base)) for k in range(solids.places))
        robot = self.solver.collision, joints, base
        return np.stack([collides(*robot, solid).any(axis=1) for solid in singles], axis=1)

    @property
    def _heights(self) -> tuple[float, float]:
        """The least and the greatest height of the EE, metres, ignoring self-collision."""
        heights = self._without[0][1].ee_pose[:, 2].clip(0.0)
        return float(heights.min()), float(heights.max())

    @cached_property
    def _without(self) -> list[tuple[str, Postures]]:
        """Pairs of a limit and postures that keep only this limit and those before it."""
        robot, options = replace(self.solver.robot, max_gravity_load=None), self.solver.options
        free = Postures(IkSolver(robot, replace(options, self_collision=False)))
        if not self.solver.gravity.limited:
            return [("orientation", free)]
        return [("orientation", free), ("self-collision", Postures(IkSolver(robot, options)))]

    def _search(
        self,
        goal: Array,
        stages: tuple[int, ...],
        solids: Solids | None = None,
        start: Array | None = None,
        count: int = 1,
        postures: Postures | None = None,
    ) -> tuple[Array, Array]:
        """Return base poses and arms of the stages until `count` are found.

        Stages with IK restarts follow only while there is none.
        """
        postures, quick = postures or self._postures, _SETTINGS.first
        base, joints = np.empty((0, 7)), np.empty((0, postures.joints.shape[1]))
        rounds = [(pair, False) for pair in pairwise((0, *quick))]
        rounds += [(pair, True) for pair in pairwise((0, *stages))]
        for numbers, restarts in rounds:
            if len(base) >= (1 if restarts else count):
                break
            more = postures.reaching(goal, numbers, solids, start, restarts=restarts)
            base, joints = np.concatenate([base, more[0]]), np.concatenate([joints, more[1]])
        return base, joints

    def _rated(
        self, base: Array, joints: Array, solids: Solids | None, count: int, *, single: bool = False
    ) -> Placement:
        """Return the best of m base poses with arms for n EE poses, shape (m, n, j)."""
        lower, upper = self.solver.robot.joint_limits
        bounded = ~self.solver.robot.continuous & (upper > lower)
        q = joints[..., bounded]
        beside = np.minimum(q - lower[bounded], upper[bounded] - q) / (upper - lower)[bounded]
        rated = Placement(
            base,
            joints[:, 0] if single else joints,
            beside.clip(0.0).min(axis=(1, 2), initial=0.5),
            self._clearance(base, joints, solids),
            (_manipulability(self.solver, joints) / self._best).min(axis=1).clip(max=1.0),
        )
        return rated.of(np.argsort(-rated.margin, kind="stable")[:count])

    def _clearance(self, base: Array, joints: Array, solids: Solids | None) -> Array:
        if solids is None:
            return np.full(len(base), _SETTINGS.clearances[-1])
        clearance = np.zeros(joints.shape[:2])
        free = np.ones_like(clearance, dtype=np.bool_)
        for distance in _SETTINGS.clearances:
            at, pose = np.nonzero(free)
            grown = solids.wider(distance, distance).repeated(len(at))
            touching = collides(self.solver.collision, joints[at, pose], base[at], grown)
            free[at, pose] = ~touching.any(axis=1)
            clearance[free] = distance
        return clearance.min(axis=1)

    def _in_the_way(self, goal: Array, solids: Solids) -> tuple[int, ...]:
        """Return the places of the smallest, then most frequent, set of solids that are touched."""
        base, joints = self._search(goal, (_SETTINGS.unlimited,))
        touching = self.touching(base, joints, solids)
        touching = touching[touching.any(axis=1)]
        if not len(touching):
            return ()
        fewest = touching[touching.sum(axis=1) == touching.sum(axis=1).min()]
        sets, counts = np.unique(fewest, axis=0, return_counts=True)
        return tuple(np.flatnonzero(sets[counts.argmax()]).tolist())

    def _none(self, limit: str) -> Placement:
        joints = len(self.solver.robot.arm)
        none, heights = np.empty(0), self._heights if limit == "height" else (0.0, 0.0)
        bases, arms = np.empty((0, 7)), np.empty((0, joints))
        return Placement(bases, arms, none, none, none, limit, heights=heights)


def _nearest_first(candidates: Sequence[Array]) -> Array:
    """Return all base poses of some sets, (m, 7), first those near to a pose of each other set."""
    # A heading counts as a point on the circle of 1 m.
    points = [
        np.hstack([poses[:, :2], rotation(poses).as_matrix()[:, 0, :2]]) for poses in candidates
    ]
    distances = [np.asarray(KDTree(own).query(np.vstack(points))[0]) for own in points]
    order = np.argsort(np.max(distances, axis=0), kind="stable")
    nearest: Array = np.vstack(candidates)[order]
    return nearest


def _manipulability(solver: IkSolver, joints: Array) -> Array:
    """Return Yoshikawa's measure at joint positions (..., j), shape (...)."""
    matrix = jacobian(solver.chain, joints)
    transposed = matrix.swapaxes(-1, -2)
    square = matrix @ transposed if matrix.shape[-1] >= POSE_DIMENSIONS else transposed @ matrix
    return np.sqrt(np.linalg.det(square).clip(0.0))
