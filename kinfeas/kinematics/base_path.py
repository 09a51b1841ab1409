"""Base paths along the whole path of an EE, by dynamic programming over sampled base poses."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from kinfeas.core.solids import Solids
from kinfeas.core.spatial import (
    IDENTITY,
    Array,
    compose,
    integrate,
    planar_pose,
    relative,
    twist_between,
    wrap,
    yaw,
)
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver, spread
from kinfeas.kinematics.reachability import Postures, at_goals
from kinfeas.kinematics.solids import collides, in_base
from kinfeas.robots.robot import joint_displacement

_NEW, _KEPT, _VARIATIONS = 128, 48, 8
"""Base poses that are proposed for an EE pose; cheapest ones before it that go on to it, with the
arm or standing, and variations of those."""

_VARIATION = np.array([0.04, 0.04, 0.06])
"""Standard deviation of variations, metres and radians."""

_TURN_COST, _JOINT_COST, _JUMP_COST = 0.3, 0.02, 3.0
"""Metres of base motion that cost as much as a radian of turning, a second of joint motion, and a
jump: a unit beyond `_REACH` or beyond the joint velocities."""

_REACH = np.array([0.06, 0.25])
"""Joint motion between two EE poses that counts as no jump: prismatic, metres; others, radians."""

_SHARE = 0.85
"""Share of the velocity limits that a base path uses."""

_CLEARANCE = 0.04
"""Distance that the base keeps from solids, metres: more than the obstacle filter keeps."""

_ON_THE_WAY, _ROUNDS = (0.25, 0.5, 0.75), 3
"""Shares of a way at which the base is checked for collisions, and ways tried for each pose."""


class _Layer(NamedTuple):
    """Robots that reach an EE pose.

    Attributes:
        base: x, y and heading, shape (m, 3).
        joints: Arms, shape (m, j).
        cost: Cost of the way to each, shape (m,).
        before: Number of the robot in the layer before, shape (m,).
    """

    base: Array
    joints: Array
    cost: Array
    before: NDArray[np.intp]


class BasePathPlanner:
    """Finds base and arm motions of one robot for a whole EE path."""

    def __init__(self, solver: IkSolver) -> None:
        """Prepare proposals of base poses."""
        self.robot, self.postures = solver.robot, Postures(solver)
        # A pose tolerance would add up along the path.
        self.solver = IkSolver(solver.robot, at_goals(solver.robot, solver.options))
        count = _KEPT * _VARIATIONS
        self._variations = _VARIATION * ndtri(spread(count, 3)).reshape(_VARIATIONS, _KEPT, 3)
        kinds = [self.robot.urdf.joints[joint.name].kind for joint in self.robot.arm]
        self._reach = _REACH[[int(kind != "prismatic") for kind in kinds]]

    def plan(
        self,
        ee_path: Array,
        seconds: Array,
        base_pose: Array,
        joint_positions: Array,
        solids: Solids | None = None,
    ) -> Array | None:
        """Return arm joints along the EE path, shape (k, j), or None if no path is found.

        The base pose of each follows by `base_at`.

        Args:
            ee_path: World poses of the EE, shape (k, 7), the first one at present.
            seconds: Time from each to the next one, shape (k - 1,).
            base_pose: World pose of the base now, shape (7,).
            joint_positions: Arm joints now, shape (j,).
            solids: In the world, one row.
        """
        pose = base_pose[np.newaxis]
        start = np.concatenate([pose[0, :2], yaw(pose)])[np.newaxis]
        layers = [_Layer(start, joint_positions[np.newaxis], np.zeros(1), np.zeros(1, np.intp))]
        for leg in zip(ee_path[:-1], ee_path[1:], seconds, strict=True):
            layer = self._next(layers[-1], *leg, solids)
            if not len(layer.cost):
                return None
            layers.append(layer)
        number, path = int(layers[-1].cost.argmin()), []
        for layer in reversed(layers):
            path.append(layer.joints[number])
            number = int(layer.before[number])
        return np.array(path[::-1])

    def base_at(self, ee_pose: Array, joint_positions: Array) -> Array:
        """Return x, y and heading of the bases, (n, 3), of EE poses (n, 7) and arms (n, j)."""
        ee = forward(self.solver.chain, joint_positions)
        pose = compose(ee_pose, relative(np.broadcast_to(IDENTITY, ee.shape), ee))
        return np.column_stack([pose[:, :2], yaw(pose)])

    def _next(
        self, last: _Layer, ee_before: Array, ee_pose: Array, time: float, solids: Solids | None
    ) -> _Layer:
        """Return the robots that reach an EE pose from those at the one before."""
        base, joints = self._proposed(last, ee_pose)
        ways = base[:, np.newaxis] - last.base
        near = np.linalg.norm(ways[..., :2], axis=2).min(axis=1)
        rows = np.flatnonzero(near <= _SHARE * self.robot.base.max_velocity * time)
        base, joints = base[rows], joints[rows]
        rows = np.flatnonzero(~self._collides(base, joints, solids))
        base, joints = base[rows], joints[rows]
        pose = planar_pose(*base.T)
        arm = self.solver.solve(
            relative(np.broadcast_to(ee_pose, pose.shape), pose),
            joints,
            solids=None if solids is None else in_base(_repeated(solids, len(pose)), pose),
        )
        base, joints = base[arm.feasible], arm.joint_positions[arm.feasible]
        cost = last.cost + self._costs(last, base, joints, time)
        every = np.arange(len(base))
        for _ in range(_ROUNDS):
            before = cost.argmin(axis=1) if len(base) else every
            begin = last.joints[before]
            way = joint_displacement(self.robot, begin, joints)
            hit = np.zeros(len(base), dtype=np.bool_)
            for share in _ON_THE_WAY:
                pose = integrate(ee_before, share * twist_between(ee_before, ee_pose, 1.0), 1.0)
                arms = begin + share * way
                there = self.base_at(np.broadcast_to(pose, (len(arms), 7)), arms)
                hit |= self._collides(there, arms, solids)
            cost[every[hit], before[hit]] = np.inf
            if not hit.any():
                break
        before = cost.argmin(axis=1) if len(base) else every
        least = cost[every, before]
        kept = np.isfinite(least)
        return _Layer(base[kept], joints[kept], least[kept], before[kept])

    def _proposed(self, last: _Layer, ee_pose: Array) -> tuple[Array, Array]:
        """Return base poses, (m, 3), and arms from which IK begins, (m, j)."""
        new, new_joints = self.postures.around(ee_pose, 0, _NEW)
        kept = np.argsort(last.cost, kind="stable")[:_KEPT]
        joints = last.joints[kept]
        carried = self.base_at(np.broadcast_to(ee_pose, (len(kept), 7)), joints)
        half = carried - last.base[kept]
        half[:, 2] = wrap(half[:, 2])
        half = last.base[kept] + 0.5 * half
        varied = (carried + self._variations[:, : len(kept)]).reshape(-1, 3)
        base = np.concatenate([new, last.base[kept], carried, half, varied])
        return base, np.concatenate([new_joints, *[joints] * (3 + _VARIATIONS)])

    def _costs(self, last: _Layer, base: Array, joints: Array, time: float) -> Array:
        """Return the cost of each robot, m, after each of the last ones, l, shape (m, l)."""
        limits = self.robot.base
        way = base[:, np.newaxis] - last.base
        length, turn = np.linalg.norm(way[..., :2], axis=2), np.abs(wrap(way[..., 2]))
        moved = np.abs(joint_displacement(self.robot, last.joints, joints[:, np.newaxis]))
        needed = moved / self.robot.max_joint_velocity
        jump = np.maximum((moved / self._reach).max(axis=2) - 1.0, 0.0) * _REACH[1]
        jump += np.maximum(needed.max(axis=2) / time - 0.9, 0.0)
        cost = length + _TURN_COST * turn + _JOINT_COST * needed.sum(axis=2) + _JUMP_COST * jump
        allowed = length <= _SHARE * limits.max_velocity * time
        allowed &= turn <= _SHARE * limits.max_rotation * time
        return np.where(allowed, cost, np.inf)

    def _collides(self, base: Array, joints: Array, solids: Solids | None) -> NDArray[np.bool_]:
        if solids is None:
            return np.zeros(len(base), dtype=np.bool_)
        margin = np.where(solids.filled[..., np.newaxis], [_CLEARANCE, _CLEARANCE, 0.0, 0.0], 0.0)
        wide = _repeated(replace(solids, size=solids.size + margin), len(base))
        return collides(self.solver.collision, joints, planar_pose(*base.T), wide)[:, 0]


def _repeated(solids: Solids, n: int) -> Solids:
    return solids.of(np.zeros(n, dtype=np.intp))
