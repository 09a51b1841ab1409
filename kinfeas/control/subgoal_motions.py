"""Motions of n EEs from sub-goal to sub-goal, without head starts, settling and dwells."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.ee_motions import EeMotions, Motions
from kinfeas.control.execution import GRASP_METRES, SubgoalMotion, tool_pose
from kinfeas.control.observation import HORIZON
from kinfeas.control.whole_body_motion import PlannedRobots, WholeBodyMotions
from kinfeas.core import spatial
from kinfeas.core.metrics import GOAL_RADIANS
from kinfeas.core.motion import Rngs, Rows, State, with_rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver

LONGEST = 300.0  # seconds after which the preview of a motion ends

_END_SECONDS, _REST = 1.0, 1e-6
"""Seconds for which a motion must have counted as ended, since it may still be moving then, and the
displacement in `HORIZON` seconds, metres or radians, below which an EE is at rest."""

_PATHS = "waypoints"

_T = TypeVar("_T")


@dataclass(frozen=True)
class MotionStep:
    """Next step of the motions of n EEs."""

    desired: Array  # desired world poses of the EE after the step, shape (n, 7)
    preview: Array  # the same after `HORIZON` seconds at the step's twist, shape (n, 7)
    states: list[State]  # state of each generator after the step
    seconds: Array  # motion time of the step, shape (n,)


class SubgoalMotions:
    """The desired motion of n EEs through the same sub-goals.

    No row depends on the others: the random numbers of a sub-goal depend only on the seed of its
    row and its number. Arrays are replaced, never written into, since others may hold them.

    Attributes:
        desired: Desired world pose of the EE, shape (n, 7).
        subgoal: Number of the sub-goal that each row is at, shape (n,).
        elapsed: Motion time since the motion of each row's sub-goal began, seconds, shape (n,).
        avoids_solids: Whether the generator of any sub-goal plans around solids.
        whole_body: Paths of base and arm that the motions follow among solids.
    """

    ROWS: tuple[str, ...] = ("desired", "subgoal", "_seeds", "_targets", "elapsed")
    """Names of the arrays with a row for each motion."""

    desired: Array
    subgoal: NDArray[np.intp]
    elapsed: Array
    _seeds: NDArray[np.uint64]
    _targets: Array

    def __init__(
        self, subgoals: Sequence[SubgoalMotion], solver: IkSolver, dt: float, time_scale: float
    ) -> None:
        """Move in periods of `dt` seconds, slower by the factor `time_scale`."""
        self.subgoals, self._motions = tuple(subgoals), EeMotions(subgoals)
        tool, nothing = tool_pose(solver.robot), np.tile(spatial.IDENTITY, (len(subgoals), 1))
        tips = np.array([subgoal.frame == "tip" for subgoal in subgoals])
        self._tips, self._tool = bool(tips.any()), np.where(tips[:, np.newaxis], tool, nothing)
        self._ee_in_tool = spatial.relative(nothing, self._tool)
        generators = self._motions.generators
        self.avoids_solids = any(generator.avoids_solids for generator in generators)
        self._solids: Solids | None = None
        self.whole_body = WholeBodyMotions(solver, dt, time_scale, generators)
        self._kept: dict[str, Any] = {}

    def start(self, ee_pose: Array, targets: Array, rngs: Rngs, rows: Rows | None = None) -> None:
        """Begin the first sub-goal.

        Args:
            ee_pose: World pose of the EE in m rows, shape (m, 7).
            targets: Targets of their sub-goals, shape (m, sub-goals, 7).
            rngs: One source of randomness for each of them.
            rows: Which of the n rows begin anew; all of them by default, which also sets n.
        """
        n = len(rngs)
        zeros = np.zeros(n, dtype=np.intp)
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs], dtype=np.uint64)
        fresh = ee_pose, zeros, seeds, targets, np.zeros(n)
        self._put(dict(zip(SubgoalMotions.ROWS, fresh, strict=True)), rows)
        if rows is None:
            self._motions.clear(zeros)
            self.whole_body.start(n)
            self._solids, rows = None, np.arange(n)
        self._begin(rows)

    @property
    def goal(self) -> Array:
        """World pose of the EE at the end of each row's sub-goal, shape (n, 7)."""
        return self.until_changed("goal", self._goal)

    @property
    def last(self) -> NDArray[np.bool_]:
        """Whether each row is at its last sub-goal, shape (n,)."""
        return self.subgoal == len(self.subgoals) - 1

    @property
    def demonstrated_base(self) -> Array:
        """World pose of the base in the demonstration now, shape (n, 7), or NaN."""
        targets = self._target
        return self._motions.ask(
            lambda group: group.generator.base_pose(group.state, targets[group.rows])
        )

    @property
    def planned(self) -> PlannedRobots:
        """Bases and arms on whole-body paths; see `PlannedRobots` for the times."""
        return self.until_changed("planned", lambda: self.whole_body.soon(self._motions))

    def until_changed(self, name: str, compute: Callable[[], _T]) -> _T:
        """Return a computed value, which is cached by its name until the motions change."""
        if name not in self._kept:
            self._kept[name] = compute()
        return self._kept[name]

    def aim(self, target_poses: Array) -> None:
        """Replace the targets of each row's sub-goal, shape (n, 7)."""
        self._targets = self._targets.copy()
        self._targets[np.arange(len(self.subgoal)), self.subgoal] = target_poses
        self._changed()

    def avoid(
        self, solids: Solids, rows: Rows | None = None, robots: tuple[Array, Array] | None = None
    ) -> None:
        """Plan the motions of rows around the solids at their present positions.

        Motions of later sub-goals also avoid them; those that `start` begins do not.

        Args:
            solids: Solids around each of the n rows.
            rows: Which motions are planned anew; all of them by default.
            robots: World poses of the bases, shape (n, 7), and arm joints, shape (n, j), now, from
                which whole-body paths begin.
        """
        self._solids, self.whole_body.robots = solids, robots
        if self.avoids_solids:
            self._replan(np.arange(len(self.subgoal)) if rows is None else rows)

    def ahead(self, distances: Array) -> Array:
        """Return the EE poses some metres ahead of the desired ones, shape (d,) -> (n, d, 7).

        They lie on the path of the sub-goal and end at its goal. Generators that do not look ahead
        move straight.
        """
        frame, targets = self._to_frame(self.desired), self._target

        def answer(group: Motions) -> Array:
            rows = group.rows
            return group.generator.ahead(group.state, frame[rows], targets[rows], distances)

        poses = self._motions.ask(answer)
        if not self._tips:
            return poses
        return spatial.compose(poses, self._ee_in_tool[self.subgoal][:, np.newaxis])

    def ended(self, near: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which of the rows that are near their goal are at the end of their motion, (n,).

        Motions along a path of their own also have to be at the end of it.
        """
        return self._ended(self._motions, near)

    def copied(self) -> Self:
        """Return a copy of the motions that advances independently.

        Both share arrays, which are never written into.
        """
        twin = copy.copy(self)
        twin._motions, twin._kept = self._motions.at(self._motions.states), dict(self._kept)
        return twin

    def to_the_end(self, rows: Rows, *, to_rest: bool = False) -> list[Array]:
        """Return the desired poses every `HORIZON` seconds until the end of a sub-goal, (k, 7).

        There is one array for each of the rows; the motions do not advance. With `to_rest` the
        poses go on until the motion has ended and the EE is at rest.
        """
        desired, motions = self.desired, self._motions
        counts, ended_periods = np.zeros((2, len(rows)), dtype=np.intp)
        poses, goal = [desired[rows]], self.goal[rows]
        while not counts.all() and len(poses) * HORIZON < LONGEST:
            step = self._step(motions, desired, HORIZON)
            desired, motions = step.desired, motions.at(step.states)
            poses.append(desired[rows])
            metres, radians = spatial.distance(poses[-1], goal)
            near = np.zeros(len(desired), dtype=np.bool_)
            near[rows] = (metres <= GRASP_METRES) & (radians <= GOAL_RADIANS)
            ended = self._ended(motions, near)[rows]
            if to_rest:
                ended_periods = np.where(ended, ended_periods + 1, 0)
                moved = np.maximum(*spatial.distance(poses[-2], poses[-1]))
                ended = (ended_periods * HORIZON > _END_SECONDS) & (moved < _REST)
            counts = np.where((counts == 0) & ended, len(poses), counts)
        counts[counts == 0] = len(poses)
        return [np.stack([pose[i] for pose in poses[:k]]) for i, k in enumerate(counts.tolist())]

    def step_of(self, seconds: float | Array) -> MotionStep:
        """Return the next step of some seconds, one number or shape (n,), 0 for rest.

        The motions do not advance; see `move`.
        """
        return self._step(self._motions, self.desired, seconds)

    def after(self, step: MotionStep, paused: NDArray[np.bool_] | None = None) -> Array:
        """Return the desired poses after a step, shape (n, 7); those now in paused rows."""
        if paused is None:
            return step.desired
        return np.where(paused[:, np.newaxis], self.desired, step.desired)

    def move(self, step: MotionStep, paused: NDArray[np.bool_] | None = None) -> None:
        """Carry out a step, except in the rows that are `paused`, shape (n,)."""
        self._motions.move(step.states, paused)
        self.desired = self.after(step, paused)
        passed = step.seconds if paused is None else np.where(paused, 0.0, step.seconds)
        self.elapsed = self.elapsed + passed
        self._changed()

    def begin_again(self, rows: Rows) -> None:
        """Restart the motions of `rows` from their desired poses, for example after a wait."""
        if rows.size:
            self._begin(rows)
            self._replan(rows)

    def begin_next(self, rows: NDArray[np.bool_]) -> None:
        """Begin the next sub-goal of rows, shape (n,), that are not at their last one."""
        rows = rows & ~self.last
        self.subgoal = self.subgoal + rows
        self.begin_again(np.flatnonzero(rows))

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as arrays by name."""
        own = {name: getattr(self, name) for name in self.ROWS}
        return own | {_PATHS: self.whole_body.waypoints} | self._motions.snapshot()

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        self._put({name: snapshot[name].copy() for name in self.ROWS})
        self._motions.restore(snapshot, self.subgoal)
        self._changed()
        self._solids = self.whole_body.robots = None
        self.whole_body.waypoints = snapshot[_PATHS].copy()

    def _put(self, arrays: Mapping[str, NDArray[Any]], rows: Rows | None = None) -> None:
        """Replace arrays by name, or some rows of them."""
        for name, values in arrays.items():
            setattr(self, name, with_rows(getattr(self, name, values), rows, values))

    def _begin(self, rows: Rows) -> None:
        """Start the motion of the sub-goal that each of `rows` is at, from its desired pose."""
        self.whole_body.drop(rows)
        self.elapsed = with_rows(self.elapsed, rows, np.array(0.0))
        motions, frame, targets = self._motions, self._to_frame(self.desired), self._target
        motions.assign(self.subgoal)
        for group in motions.of(rows):
            keys = zip(
                self._seeds[group.rows].tolist(), self.subgoal[group.rows].tolist(), strict=True
            )
            rngs = [np.random.default_rng(key) for key in keys]
            motions.put(group, group.generator.start(frame[group.rows], targets[group.rows], rngs))
        self._changed()

    def _replan(self, rows: Rows) -> None:
        """Let the motions of `rows` avoid the solids, if there are any."""
        if self._solids is None or not self.avoids_solids or not rows.size:
            return
        frame, targets = self._to_frame(self.desired), self._target
        for group in self._motions.of(rows):
            if group.generator.avoids_solids:
                state, poses = group.state, (frame[group.rows], targets[group.rows])
                solids = self._solids.of(group.rows)
                if group.generator.follows_whole_body:
                    ends = self.goal[group.rows], self._tool[self.subgoal[group.rows]]
                    state = self.whole_body.follow(group, poses, ends, solids)
                self._motions.put(group, group.generator.replan(state, *poses, solids))
        self._changed()

    @property
    def _target(self) -> Array:
        return self._targets[np.arange(len(self.subgoal)), self.subgoal]

    def _changed(self) -> None:
        self._kept = {}

    def _goal(self) -> Array:
        targets, ask = self._target, self._motions.ask
        return self._to_ee(
            ask(lambda group: group.generator.goal_pose(group.state, targets[group.rows]))
        )

    def _step(self, motions: EeMotions, desired: Array, seconds: float | Array) -> MotionStep:
        frame, targets = self._to_frame(desired), self._target
        durations = np.full(len(frame), seconds)
        twist, states = motions.twist(frame, targets, durations)
        after = preview = self._to_ee(spatial.integrate(frame, twist, seconds))
        if isinstance(seconds, np.ndarray) or seconds != HORIZON:
            preview = self._to_ee(spatial.integrate(frame, twist, HORIZON))
        if not durations.all():
            rests = durations[:, np.newaxis] == 0.0
            after, preview = (np.where(rests, desired, pose) for pose in (after, preview))
        return MotionStep(after, preview, states, durations)

    def _ended(self, motions: EeMotions, near: NDArray[np.bool_]) -> NDArray[np.bool_]:
        ended, targets = near.copy(), self._target
        for group in motions.of(np.flatnonzero(near)):
            ended[group.rows] = group.generator.finished(group.state, targets[group.rows])
        return ended

    def _to_frame(self, ee_pose: Array) -> Array:
        """Return the pose of the frame that each row's sub-goal moves, shape (n, 7)."""
        return spatial.compose(ee_pose, self._tool[self.subgoal]) if self._tips else ee_pose

    def _to_ee(self, frame: Array) -> Array:
        """Return the EE poses that put the moved frames at `frame`, shape (n, 7)."""
        return spatial.compose(frame, self._ee_in_tool[self.subgoal]) if self._tips else frame


def begin_motions(
    solver: IkSolver, subgoals: Sequence[SubgoalMotion], start: Start, rngs: Rngs
) -> SubgoalMotions:
    """Return the motions of n episodes at their start, in steps of `HORIZON`."""
    motions = SubgoalMotions(subgoals, solver, HORIZON, 1.0)
    ee = spatial.compose(start.base_pose, forward(solver.chain, start.joint_positions))
    motions.start(ee, start.target_poses, rngs)
    return motions


def subgoal_ends(
    solver: IkSolver, subgoals: Sequence[SubgoalMotion], start: Start, rngs: Rngs
) -> Array:
    """Return the EE poses at the ends of all sub-goals, shape (n, sub-goals, 7).

    Each sub-goal begins exactly at the end of the one before.
    """
    motions = begin_motions(solver, subgoals, start, rngs)
    ends = []
    for _ in subgoals:
        ends.append(motions.goal)
        motions.desired = ends[-1]
        motions.begin_next(np.ones(len(rngs), dtype=np.bool_))
    return np.stack(ends, axis=1)
