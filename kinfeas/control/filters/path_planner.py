"""The path planner: base and arm follow a path that is planned for the whole EE motion."""

from collections.abc import Mapping
from concurrent.futures import Executor, Future

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.observation import HORIZON
from kinfeas.control.period import Period
from kinfeas.control.targets import TargetStream
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.spatial import Array, distance, wrap, yaw
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.base_path import BasePath, BasePathPlanner
from kinfeas.robots.robot import Base, Robot, joint_displacement

_OFF_EE, _OFF_BASE, _OFF_ARM = 0.02, 0.05, 0.3
"""Deviations of EE, base and arm from a path beyond which it is planned anew, metres and radians or
metres."""

_OFF_START = 0.1  # the largest one of base, its yaw and joints with which a plan may begin

_REPLAN_SECONDS = 2.0
"""Control time until a motion may be planned anew; it doubles each time no whole path is found."""

_GAIN, _GENTLE = 3.0, 1.5
"""Feedback of the base's deviation, 1/s; the second one for late bases whose arm compensates."""

_STEER, _MOVING = 3.0, 0.05
"""Angle by which a differential base steers towards its path for each metre beside it, radians; and
the speed from which on it does, m/s."""

_WAITS_METRES, _WAITS_RADIANS, _LEAST = 0.015, 0.04, 0.2
"""Deviations of a late base beyond which the EE slows down in inverse proportion, and its least
speed as a fraction."""


class PathPlanner:
    """Plans base and arm along each EE motion when it begins, and follows these paths.

    The EE slows down where the robot needs more time. A path that the robot has left, or that ends
    before its motion, is planned again. The policy acts where no path is found, and after the end
    of a path. With an executor robots begin a motion when its path is found, and move on while it
    is planned again. Paths begin in the head start, while the EE rests. With a stream of targets
    there is nothing to plan.

    Args:
        solver: IK of the robot.
        dt: Control period, seconds.
        execution: Execution of the motions.
        stream: Targets that move, if there are any.
        executor: Runs the searches beside the loop.

    Attributes:
        max_batch: Largest number of episodes side by side; a plan takes about a second for each.
    """

    max_batch = 32

    def __init__(
        self,
        solver: IkSolver,
        dt: float,
        execution: ExecutionConfig,
        stream: TargetStream | None = None,
        executor: Executor | None = None,
    ) -> None:
        self._planner, self._robot = BasePathPlanner(solver), solver.robot
        self._follower, self._idle = PathFollower(solver.robot, dt), stream is not None
        self._dt, self._time_scale, self._executor = dt, execution.time_scale, executor
        self._paths: dict[int, BasePath] = {}
        self._search: Future[dict[int, BasePath | None]] | None = None
        self._subgoal = self._again_at = np.empty(0, dtype=np.intp)
        self._wait: Array = np.empty(0)
        self._open: NDArray[np.bool_] = np.empty(0, dtype=np.bool_)  # without a complete path

    def reset(self, rows: Rows, n: int) -> None:
        """Forget the paths of new episodes in `rows` of n."""
        if len(rows) == n:
            self._subgoal, self._again_at = np.zeros((2, n), dtype=np.intp)
            self._wait, self._open = np.zeros(n), np.zeros(n, dtype=np.bool_)
            self._paths, self._search = {}, None
        self._subgoal[rows] = -1

    def __call__(self, period: Period) -> Period:
        """Return the period with commands along the paths."""
        if self._idle:
            return period
        elapsed = period.motions.elapsed
        if self._search is None and (due := self._due(period)).size:
            self._plan(due, period)
        if self._search is not None:
            if self._search.done():
                self._store(self._search.result())
                self._search = None
            elif (rests := elapsed == 0.0).any():
                period = period.slowed(np.where(rests, 0.0, period.time_scale))
                period = period.commanded(np.where(rests[:, np.newaxis], 0.0, period.command))
        same = self._subgoal == period.motions.subgoal  # a search may end after its motion
        self._paths = {
            row: path
            for row, path in self._paths.items()
            if same[row] and elapsed[row] < path.seconds[-1]
        }
        return self._follower(period, self._paths)

    def _plan(self, rows: Rows, period: Period) -> None:
        motions, subgoal = period.motions, period.motions.subgoal[rows]
        again = self._subgoal[rows] == subgoal
        failed = again & self._open[rows]
        self._wait[rows] = np.where(failed, 2.0 * self._wait[rows], _REPLAN_SECONDS)
        self._subgoal[rows] = subgoal
        self._again_at[rows] = motions.periods[rows] + np.ceil(self._wait[rows] / self._dt)
        for row in rows[~again]:
            self._paths.pop(row, None)
        copied = period.changed(motions=motions.copied())
        if self._executor is None:
            self._store(self._find_paths(rows, copied))
        else:
            self._search = self._executor.submit(self._find_paths, rows, copied)

    def _store(self, paths: dict[int, BasePath | None]) -> None:
        for row, path in paths.items():
            self._open[row] = path is None or not path.complete
            self._paths.pop(row, None)
            if path is not None:
                self._paths[row] = path

    def _find_paths(self, rows: Rows, period: Period) -> dict[int, BasePath | None]:
        motions, solids = period.motions, period.solids
        paths: dict[int, BasePath | None] = {}
        for row, ee in zip(rows.tolist(), motions.to_the_end(rows), strict=True):
            paths[row] = self._planner.plan(
                period.base_pose[row],
                period.joints[row],
                ee,
                HORIZON,
                begin=motions.elapsed[row],
                rest=motions.elapsed[row] - motions.clock[row],
                time_scale=self._time_scale,
                solids=None if solids is None else solids.of(np.array([row])),
                partial=True,
            )
        return paths

    def _due(self, period: Period) -> Rows:
        motions = period.motions
        due: NDArray[np.bool_] = self._open & (motions.periods >= self._again_at)
        due[list(self._paths)] = False
        due |= self._subgoal != motions.subgoal
        rows = np.array([row for row in self._paths if not due[row]], dtype=np.intp)
        rows = rows[motions.periods[rows] >= self._again_at[rows]]
        if rows.size:
            clock = motions.clock
            base, arm = off_path(self._robot, period, rows, robots_on(self._paths, rows, clock))
            ee = np.stack([self._paths[row].ee_at(clock[row]) for row in rows.tolist()])
            due[rows] = distance(ee, motions.desired[rows])[0] > _OFF_EE
            due[rows] |= (base > _OFF_BASE) | (arm > _OFF_ARM)
        return np.flatnonzero(due)


class PathFollower:
    """Moves bases and arms along paths; the EE waits for bases that respond late."""

    def __init__(self, robot: Robot, dt: float) -> None:
        self._robot, self._dt = robot, dt

    def __call__(self, period: Period, paths: Mapping[int, BasePath]) -> Period:
        """Return the period with the commands of the rows that have a path."""
        rows = np.array(list(paths), dtype=np.intp)
        if not rows.size:
            return period
        clock, scale = period.motions.clock, period.time_scale.copy()
        scale[rows] *= [path.time_scale_at(clock[row]) for row, path in paths.items()]
        now, base_pose = robots_on(paths, rows, clock), period.base_pose[rows]
        if period.motion is not None:
            metres, radians = _base_deviations(base_pose, now)
            late = np.maximum(metres / _WAITS_METRES, radians / _WAITS_RADIANS)
            scale[rows] *= np.clip(1.0 / np.maximum(late, 1.0), _LEAST, 1.0)
        if (scale != period.time_scale).any():
            period = period.slowed(scale)
        then = robots_on(paths, rows, period.motions.clock_after(period.motion_seconds))
        guide = period.posture_guide
        guide = np.full_like(period.joints, np.nan) if guide is None else guide
        gentle = period.motion is not None and self._robot.pose_tolerance is None
        gain = _GENTLE if gentle else _GAIN
        along = follow(self._robot.base, base_pose, now[:, :3], then[:, :3], self._dt, gain)
        return period.changed(
            command=with_rows(period.command, rows, along),
            posture_guide=with_rows(guide, rows, then[:, 3:]),
        )


class PlanFollower:
    """Follows one path, which is known before the motion begins; the policy acts after its end.

    Args:
        robot: The robot.
        dt: Control period, seconds.
        path: Base and arm for all motion times from 0 on.
    """

    max_batch = 1

    def __init__(self, robot: Robot, dt: float, path: BasePath) -> None:
        self._robot, self._path, self._follower = robot, path, PathFollower(robot, dt)

    def __call__(self, period: Period) -> Period:
        """Return the period with the command along the path.

        Raises:
            KinfeasError: If the robot is not at the beginning of the path when the motion begins.
        """
        elapsed, paths = period.motions.elapsed, {0: self._path}
        if elapsed[0] == 0.0:
            row = np.zeros(1, dtype=np.intp)
            start = robots_on(paths, row, elapsed)
            base, arm = off_path(self._robot, period, row, start)
            turn = _base_deviations(period.base_pose[row], start)[1]
            if max(base[0], turn[0], arm[0]) > _OFF_START:
                raise KinfeasError(
                    f"the robot is not at the start of the plan: the base is {base[0]:.2f} m and "
                    f"{turn[0]:.2f} rad, a joint {arm[0]:.2f} rad or m away"
                )
        return self._follower(period, paths if elapsed[0] < self._path.seconds[-1] else {})


def robots_on(paths: Mapping[int, BasePath], rows: Rows, seconds: Array) -> Array:
    """Return base and arm on the paths of m of n rows at motion times (n,), shape (m, 3 + j)."""
    return np.concatenate([paths[row].robots_at(seconds[[row]]) for row in rows.tolist()])


def off_path(robot: Robot, period: Period, rows: Rows, robots: Array) -> tuple[Array, Array]:
    """Return how far m bases, metres, and arms, radians or metres, are from `robots`, (m,) each.

    `robots` have x, y and yaw of the base and arm joints, shape (m, 3 + j). The joint that is
    farthest counts.
    """
    arm = np.abs(joint_displacement(robot, period.joints[rows], robots[:, 3:])).max(axis=1)
    return _base_deviations(period.base_pose[rows], robots)[0], arm


def _base_deviations(base_pose: Array, robots: Array) -> tuple[Array, Array]:
    """Return how far m bases are from those of `robots`, metres and radians, shape (m,) each.

    `base_pose` is a world pose, shape (m, 7); `robots` begin with x, y and yaw, shape (m, 3 + j).
    """
    metres: Array = np.linalg.norm(robots[:, :2] - base_pose[:, :2], axis=1)
    return metres, np.abs(wrap(robots[:, 2] - yaw(base_pose)))


def follow(base: Base, base_pose: Array, now: Array, then: Array, dt: float, gain: float) -> Array:
    """Return the commands in [-1, 1] that follow paths, shape (m, 3) or (m, 2).

    Args:
        base: Drive and velocity limits.
        base_pose: World pose of each base, shape (m, 7).
        now: x, y and yaw on its path now, shape (m, 3).
        then: The same a period later.
        dt: Control period in seconds.
        gain: Feedback of the base's deviation, 1/s.
    """
    heading, deviation = yaw(base_pose), now - base_pose[:, :3]
    deviation[:, 2] = wrap(now[:, 2] - heading)
    velocity = (then - now) / dt + gain * deviation
    turn, cosine, sine = velocity[:, 2], np.cos(heading), np.sin(heading)
    ahead = cosine * velocity[:, 0] + sine * velocity[:, 1]
    if base.drive == "omnidirectional":
        left = cosine * velocity[:, 1] - sine * velocity[:, 0]
        speeds = [ahead / base.max_velocity, left / base.max_velocity]
    else:
        speeds = [ahead / base.max_velocity]
        aside = cosine * deviation[:, 1] - sine * deviation[:, 0]
        turn = turn + gain * np.arctan(_STEER * aside) * np.clip(ahead / _MOVING, -1.0, 1.0)
    return np.clip(np.stack([*speeds, turn / base.max_rotation], axis=1), -1.0, 1.0)
