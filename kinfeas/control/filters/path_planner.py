"""The path planner: base and arm follow a path that is planned for the whole EE motion."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.loop import Loop
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.observation import HORIZON
from kinfeas.control.period import Period
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array, distance, wrap, yaw
from kinfeas.planning.base_path import BasePath, BasePathPlanner
from kinfeas.robots.robot import Base, joint_displacement

_OFF_EE, _OFF_BASE, _OFF_ARM = 0.02, 0.1, 0.7
"""Deviations of EE, base and arm from a path beyond which it is planned anew, metres and radians or
metres."""

_REPLAN_SECONDS = 2.0
"""Control time until a motion may be planned anew; it doubles with each plan."""

_GAIN, _STEER, _MOVING = 3.0, 3.0, 0.05
"""Feedback of the base's deviation, 1/s; angle by which a differential base steers towards its path
for each metre beside it, radians; and the speed from which on it does, m/s."""


class PathPlanner:
    """Plans base and arm along each EE motion when it begins, and follows these paths.

    The EE slows down where the robot needs more time. A path that the robot has left is planned
    again. The policy acts where no path is found, and after the end of a path.

    Attributes:
        max_batch: Episodes side by side, whose plans take about as many seconds.
    """

    max_batch = 32
    _planner: BasePathPlanner | None = None

    def __init__(self) -> None:
        self._paths: dict[int, BasePath] = {}

    def reset(self, loop: Loop, rows: NDArray[np.intp]) -> None:
        """Plan for the motions of a loop; arguments as in `CommandFilter`."""
        if loop.target_stream is not None:
            raise KinfeasError("the filter path_planner needs motions that are known in advance")
        self._loop = loop
        if self._planner is None:
            self._planner = BasePathPlanner(loop.solver)
        if len(rows) == len(loop.desired):
            self._subgoal, self._again_at = np.zeros((2, len(rows)), dtype=np.intp)
            self._wait, self._paths = np.zeros(len(rows)), {}
        self._subgoal[rows] = -1

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return the commands along the paths; arguments as in `CommandFilter`."""
        loop, elapsed = self._loop, self._loop.sequence.elapsed
        if (due := self._due()).size:
            self.plan(due)
        self._paths = {i: one for i, one in self._paths.items() if elapsed[i] < one.seconds[-1]}
        rows = np.array(list(self._paths), dtype=np.intp)
        if not rows.size:
            return command
        period = loop.period
        scale = period.time_scale.copy()
        scale[rows] *= [one.time_scale_at(elapsed[i]) for i, one in self._paths.items()]
        if (scale != period.time_scale).any():
            loop.slow_down(scale)
        now, then = self._robots(rows, 0.0), self._robots(rows, period.motion_seconds[rows])
        guide = np.full_like(period.joints, np.nan) if period.guide is None else period.guide
        period.guide = with_rows(guide, rows, then[:, 3:])
        base_pose = period.base_pose[rows]
        along = follow(loop.robot.base, base_pose, now[:, :3], then[:, :3], loop.dt)
        return with_rows(command, rows, along)

    def plan(self, rows: Rows) -> None:
        """Plan the motions of rows from now on."""
        loop = self._loop
        subgoal = loop.sequence.subgoal[rows]
        wait = 2.0 * self._wait[rows]
        self._wait[rows] = np.where(self._subgoal[rows] == subgoal, wait, _REPLAN_SECONDS)
        self._subgoal[rows] = subgoal
        self._again_at[rows] = loop.periods[rows] + np.ceil(self._wait[rows] / loop.dt)
        self._paths = {row: one for row, one in self._paths.items() if row not in rows}
        self.put(self.search(rows, loop.period, loop.sequence.copied()))

    def put(self, paths: dict[int, BasePath]) -> None:
        """Follow paths in some rows."""
        self._paths |= paths

    def search(self, rows: Rows, period: Period, sequence: MotionSequence) -> dict[int, BasePath]:
        """Return the paths that are found for rows, shape (m,), from a period of a sequence on.

        Neither changes meanwhile.
        """
        assert self._planner is not None
        found, solids = {}, period.solids
        for row, ee in zip(rows.tolist(), sequence.to_the_end(rows), strict=True):
            path = self._planner.plan(
                period.base_pose[row],
                period.joints[row],
                ee,
                HORIZON,
                begin=sequence.elapsed[row],
                time_scale=self._loop.execution.time_scale,
                solids=None if solids is None else solids.of(np.array([row])),
            )
            if path is not None:
                found[row] = path
        return found

    def _due(self) -> Rows:
        """Return the rows that need a path now."""
        loop, sequence = self._loop, self._loop.sequence
        due: NDArray[np.bool_] = self._subgoal != sequence.subgoal
        rows = np.array([row for row in self._paths if not due[row]], dtype=np.intp)
        rows = rows[loop.periods[rows] >= self._again_at[rows]]
        if rows.size:
            robots, elapsed = self._robots(rows, 0.0), sequence.elapsed
            ee = np.stack([self._paths[row].ee_at(elapsed[row]) for row in rows.tolist()])
            arm = joint_displacement(loop.robot, loop.joint_command[rows], robots[:, 3:])
            base = robots[:, :2] - loop.state.base_pose[rows, :2]
            due[rows] = distance(ee, sequence.desired[rows])[0] > _OFF_EE
            due[rows] |= np.linalg.norm(base, axis=1) > _OFF_BASE
            due[rows] |= np.abs(arm).max(axis=1) > _OFF_ARM
        return np.flatnonzero(due)

    def _robots(self, rows: Rows, seconds: Array | float) -> Array:
        """Return base and arm on the paths of m rows some motion time ahead, (m, 3 + j)."""
        then = self._loop.sequence.elapsed[rows] + seconds
        pairs = zip(rows.tolist(), then.tolist(), strict=True)
        return np.stack([self._paths[row].robot_at(when) for row, when in pairs])


def follow(base: Base, base_pose: Array, now: Array, then: Array, dt: float) -> Array:
    """Return the commands in [-1, 1] that follow paths, shape (m, 3) or (m, 2).

    Args:
        base: Drive and velocity limits.
        base_pose: World pose of each base, shape (m, 7).
        now: x, y and yaw on its path now, shape (m, 3).
        then: The same a period later.
        dt: Control period in seconds.
    """
    heading, away = yaw(base_pose), now - base_pose[:, :3]
    away[:, 2] = wrap(now[:, 2] - heading)
    velocity = (then - now) / dt + _GAIN * away
    turn, cosine, sine = velocity[:, 2], np.cos(heading), np.sin(heading)
    ahead = cosine * velocity[:, 0] + sine * velocity[:, 1]
    if base.drive == "omnidirectional":
        left = cosine * velocity[:, 1] - sine * velocity[:, 0]
        speeds = [ahead / base.max_velocity, left / base.max_velocity]
    else:
        speeds = [ahead / base.max_velocity]
        aside = cosine * away[:, 1] - sine * away[:, 0]
        turn = turn + _GAIN * np.arctan(_STEER * aside) * np.clip(ahead / _MOVING, -1.0, 1.0)
    return np.clip(np.stack([*speeds, turn / base.max_rotation], axis=1), -1.0, 1.0)
