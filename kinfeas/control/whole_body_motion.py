"""Whole-body motions that n EEs follow among solids, each row with its own."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinfeas.control.ee_motions import EeMotions, Motions
from kinfeas.core import spatial
from kinfeas.core.checks import CheckedMotion
from kinfeas.core.motion import WAYPOINTS, Rows, State, WholeBodyPath, merged, of_rows, with_rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.base_goal import CHECKED_AHEAD, BaseGoalPlanner

LEAD = 1.0  # seconds by which the planned base that policies see is ahead of the EE


class PlannedRobots(NamedTuple):
    """Robots on their paths; NaN in rows without a path."""

    base_pose: Array  # world poses of the bases in `LEAD` seconds, shape (n, 7)
    joints: Array | None  # arms after this period, shape (n, j); None if no generator follows any


class WholeBodyMotions:
    """Paths of base and arm of n EE motions, planned again where solids come into their way.

    Attributes:
        planner: Planner of the paths; None if no generator follows any.
        robots: World poses of the bases, shape (n, 7), and arm joints, shape (n, j), now; None
            while they are unknown and no path can be planned.
        waypoints: Base and arm along each row's path, shape (n, w, 3 + j), or NaN; w is 0 if no
            generator follows any.
    """

    def __init__(
        self, solver: IkSolver, dt: float, time_scale: float, generators: Iterable[CheckedMotion]
    ) -> None:
        """Plan for periods of `dt` seconds of motions slower by the factor `time_scale`."""
        used = any(generator.follows_whole_body for generator in generators)
        self.planner = BaseGoalPlanner(solver, time_scale) if used else None
        self.robots: tuple[Array, Array] | None = None
        self.waypoints: Array = np.empty((0, WAYPOINTS * used, 3 + len(solver.robot.arm)))
        self._soon, self._checked = np.array([LEAD, time_scale * dt]), time_scale * CHECKED_AHEAD

    def start(self, n: int) -> None:
        """Begin n motions, none of them with a path."""
        self.waypoints, self.robots = np.full((n, *self.waypoints.shape[1:]), np.nan), None

    def drop(self, rows: Rows) -> None:
        """Forget the paths of rows."""
        self.waypoints = with_rows(self.waypoints, rows, np.array(np.nan))

    def soon(self, motions: EeMotions) -> PlannedRobots:
        """Return bases and arms on the paths of n motions."""
        n, points, size = self.waypoints.shape
        if not points:
            return PlannedRobots(np.full((n, 7), np.nan), None)
        robot = np.full((n, len(self._soon), size), np.nan)
        for group in motions.of():
            if group.generator.follows_whole_body:
                robot[group.rows] = self._ahead(group, self._soon)
        return PlannedRobots(spatial.planar_pose(*robot[:, 0, :3].T), robot[:, 1, 3:])

    def follow(
        self, group: Motions, poses: tuple[Array, Array], ends: tuple[Array, Array], solids: Solids
    ) -> State:
        """Plan paths among solids where there is none, or it is no longer free; return the state.

        Args:
            group: The motions of r rows.
            poses: World poses of the frames that they move, and of their targets, shapes (r, 7).
            ends: World poses of the EE at their ends, and poses of the frames in that of the EE,
                shapes (r, 7).
            solids: Solids around each of the r rows.
        """
        _, generator, rows, state = group
        paths = self._paths(group, ends, solids)
        if not paths:
            return state
        new = np.array(list(paths))
        frame, target = (pose[new] for pose in poses)
        along = list(paths.values())
        followed, waypoints = generator.follow(of_rows(state, new), frame, target, along)
        self.waypoints = with_rows(self.waypoints, rows[new], waypoints)
        return merged(state, new, followed, len(rows))

    def _paths(
        self, motions: Motions, ends: tuple[Array, Array], solids: Solids
    ) -> dict[int, WholeBodyPath]:
        """Return the new paths that are needed and found, by their index in the r rows."""
        paths: dict[int, WholeBodyPath] = {}
        if self.planner is None or self.robots is None:
            return paths
        ahead, (base, joints) = self._ahead(motions, self._checked), self.robots
        for number, (row, goal, tool) in enumerate(zip(motions.rows, *ends, strict=True)):
            around = solids.of(np.array([number]))
            if not around.filled.any() or self.planner.free(ahead[number], around):
                continue
            path = self.planner.plan(base[row], joints[row], goal, around)
            if path is not None:
                paths[number] = replace(path, ee=spatial.compose(path.ee, tool))
        return paths

    def _ahead(self, motions: Motions, seconds: Array) -> Array:
        """Return base and arm of r motions some seconds ahead, (s,) -> (r, s, 3 + j), or NaN."""
        every = len(motions.rows) == len(self.waypoints)  # then there is nothing to copy
        waypoints = self.waypoints if every else self.waypoints[motions.rows]
        return motions.generator.robot_ahead(motions.state, waypoints, seconds)
