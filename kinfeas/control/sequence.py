"""Motion sequences of n EEs: sub-goals one after the other, each row at its own."""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.ee_motions import EeMotions, Motions
from kinfeas.control.execution import GRASP_METRES, ExecutionConfig, SubgoalMotion, tool_pose
from kinfeas.control.observation import HORIZON
from kinfeas.control.surroundings import Surroundings
from kinfeas.control.targets import Progress, TargetStream
from kinfeas.control.whole_body_motion import WholeBodyMotions
from kinfeas.core import spatial
from kinfeas.core.backend import Gripper, RobotState
from kinfeas.core.checks import CheckedMotion
from kinfeas.core.metrics import GOAL_RADIANS
from kinfeas.core.motion import Rows, State, with_rows
from kinfeas.core.solids import Solids
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.forward import forward
from kinfeas.kinematics.ik import IkSolver


@dataclass(frozen=True)
class MotionStep:
    """Next step of the motions of n EEs."""

    desired: Array  # desired world poses of the EE after the step, shape (n, 7)
    preview: Array  # the same after `HORIZON` seconds at the step's twist, shape (n, 7)
    states: list[State]  # state of each generator after the step
    seconds: Array  # motion time of the step, shape (n,)


_PATHS = "waypoints"
_ROWS = (
    "desired", "subgoal", "head_start", "settling", "dwelling", "_seeds", "_targets", "elapsed",
    "periods", "time_scale",
)  # fmt: skip
_STREAM = "target_stream."

_REPLAN_SECONDS = 1.0  # control time between plans around moving solids

_NO_ROWS: Rows = np.empty(0, dtype=np.intp)

LONGEST = 300.0  # seconds after which a motion counts as ended where it is looked at in advance


class MotionSequence:
    """The desired motion of n EEs through the same sub-goals.

    No row depends on the others: a sub-goal is begun with randomness that its row's seed and the
    sub-goal's number determine. Arrays are replaced, never written into, since others may hold
    them.

    Attributes:
        desired: Desired world pose of the EE, shape (n, 7).
        subgoal: Number of the sub-goal that each row is at, shape (n,).
        head_start: Control periods until each row begins the first sub-goal, shape (n,).
        settling: Control periods in which it still settles at the end of a sub-goal, shape (n,).
        dwelling: Control periods after those until it begins the next one, shape (n,).
        elapsed: Motion time since the motion of each row's sub-goal began, seconds, shape (n,).
        periods: Control periods since the start of each row, shape (n,).
        time_scale: Fraction of the planned motion that the last period carried out, shape (n,).
        stream: Targets that move; then no sub-goal ends. None for those of the start.
        revision: Number of changes of the motions so far.
        lead: Periods by which arms aim ahead of the desired motion, since they lag.
        avoids_solids: Whether the generator of any sub-goal plans around solids.
        whole_body: Paths of base and arm that the motions follow among solids.
    """

    def __init__(
        self,
        subgoals: Sequence[SubgoalMotion],
        solver: IkSolver,
        dt: float,
        execution: ExecutionConfig | None = None,
        gripper: Gripper | None = None,
        stream: TargetStream | None = None,
    ) -> None:
        execution = execution or ExecutionConfig()
        self.stream, self._gripper = stream, gripper
        self._motion_time = dt * execution.time_scale
        distinct = {
            id(subgoal.generator): CheckedMotion(subgoal.generator, subgoal.name)
            for subgoal in subgoals
        }
        order = list(distinct)
        self.subgoals, self._motions = tuple(subgoals), EeMotions(list(distinct.values()))
        self._which = np.array([order.index(id(subgoal.generator)) for subgoal in subgoals])
        self.dt, self._head_start = dt, execution.head_start
        self._head_start_jitter = execution.head_start_jitter
        grasp_settle_time = _periods(execution.grasp_settle_time / execution.time_scale, dt)
        self._periods = np.array(
            [_periods(subgoal.dwell, dt) for subgoal in subgoals], dtype=np.intp
        )
        settling = [grasp_settle_time if subgoal.grip else 0 for subgoal in subgoals]
        self._settle_periods = np.array(settling, dtype=np.intp)
        tool, nothing = tool_pose(solver.robot), np.tile(spatial.IDENTITY, (len(subgoals), 1))
        tips = np.array([subgoal.frame == "tip" for subgoal in subgoals])
        self._tips, self._tool = bool(tips.any()), np.where(tips[:, np.newaxis], tool, nothing)
        self._ee_in_tool = spatial.relative(nothing, self._tool)
        self._demonstrated = any(generator.demonstrated for generator in distinct.values())
        self.avoids_solids = any(generator.avoids_solids for generator in distinct.values())
        self._solids: Solids | None = None
        self.whole_body = WholeBodyMotions(solver, dt, execution.time_scale, distinct.values())
        self.desired: Array = np.empty((0, 7))
        self.subgoal = self.head_start = self.settling = self.dwelling = _NO_ROWS
        self.periods, self.time_scale = _NO_ROWS, np.empty(0)
        self._seeds = np.empty(0, dtype=np.uint64)
        self._targets: Array = np.empty((0, len(subgoals), 7))
        self.elapsed: Array = np.empty(0)
        self.revision, self.lead = 0, 0.0

    def start(
        self,
        ee_pose: Array,
        target_poses: Array,
        rngs: Sequence[np.random.Generator],
        rows: Rows | None = None,
    ) -> None:
        """Begin the first sub-goal.

        Args:
            ee_pose: World pose of the EE in m rows, shape (m, 7).
            target_poses: Targets of their sub-goals, shape (m, sub-goals, 7).
            rngs: One source of randomness for each of them.
            rows: Which of the n rows begin anew; all of them by default, which also sets n.
        """
        none = np.zeros(len(rngs), dtype=np.intp)
        seeds = np.array([rng.integers(2**64, dtype=np.uint64) for rng in rngs], dtype=np.uint64)
        zeros, ones = np.zeros(len(rngs)), np.ones(len(rngs))
        head_start, rest = self._head_starts(rngs), (seeds, target_poses, zeros, none, ones)
        fresh = (ee_pose, none, head_start, none, none, *rest)
        if rows is None:
            self._put(fresh)
            self._motions.clear(self._which[none])
            self.whole_body.start(len(rngs))
            self._solids, rows = None, np.arange(len(rngs))
        else:
            pairs = zip(_ROWS, fresh, strict=True)
            self._put([with_rows(getattr(self, name), rows, new) for name, new in pairs])
        self._begin(rows)

    def start_stream(self, rngs: Sequence[np.random.Generator], rows: Rows, base: Array) -> None:
        """Begin the targets of m rows that move, if any do; bases of all n rows, shape (n, 7)."""
        if self.stream is not None:
            self.stream.start(self.desired, rngs, rows)
            self.aim(self.stream.targets(self._progress(rows, base)))

    @cached_property  # until something changes
    def goal(self) -> Array:
        """World pose of the EE at the end of each row's sub-goal, shape (n, 7)."""
        targets, ask = self._target, self._motions.ask
        return self._to_ee(
            ask(lambda group: group.generator.goal_pose(group.state, targets[group.rows]))
        )

    @property
    def last(self) -> NDArray[np.bool_]:
        """Whether each row is at its last sub-goal, shape (n,)."""
        return self.subgoal == len(self.subgoals) - 1

    @property
    def resting(self) -> NDArray[np.bool_]:
        """Whether each row's desired pose rests now, shape (n,)."""
        resting: NDArray[np.bool_] = self.head_start > 0
        return resting | ((self.settling == 0) & (self.dwelling > 0))

    @property
    def demonstrated_base(self) -> Array:
        """World pose at which the base was demonstrated to be now, shape (n, 7), or NaN."""
        if not self._demonstrated:
            return np.nan * self.desired
        targets = self._target
        return self._motions.ask(
            lambda group: group.generator.base_pose(group.state, targets[group.rows])
        )

    @property
    def planned_base(self) -> Array:
        """World pose of the base on a whole-body path in `LEAD` seconds, shape (n, 7), or NaN."""
        return self._planned[0]

    @property
    def planned_joints(self) -> Array | None:
        """Arms on whole-body paths after this control period, shape (n, j), or NaN.

        None if no generator follows any.
        """
        return self._planned[1]

    def prepare(self) -> None:
        """Compute goals and the next step, which stay until something changes."""
        _ = self.goal, self.next_step, self._planned

    def aim(self, target_poses: Array) -> None:
        """Replace the targets of each row's sub-goal, shape (n, 7)."""
        self._targets = self._targets.copy()
        self._targets[np.arange(len(self.subgoal)), self.subgoal] = target_poses
        self._changed()

    def avoid(
        self, solids: Solids, rows: Rows | None = None, robots: tuple[Array, Array] | None = None
    ) -> None:
        """Plan the motions of rows around the solids as they stand now.

        Motions that begin later, at other sub-goals, also avoid them; those of `start` do not.

        Args:
            solids: Solids around each of the n rows.
            rows: Which motions are planned anew; all of them by default.
            robots: World poses of the bases, shape (n, 7), and arm joints, shape (n, j), now; some
                generators plan for them, too.
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
        if self.stream is not None:
            return np.zeros_like(near)
        ended, targets = near.copy(), self._target
        for group in self._motions.of(np.flatnonzero(near)):
            ended[group.rows] = group.generator.finished(group.state, targets[group.rows])
        return ended

    def copied(self) -> "MotionSequence":
        """Return a copy that moves on its own; they share arrays, which are never written into."""
        twin = copy.copy(self)
        twin._motions = copy.copy(self._motions)
        return twin

    def to_the_end(self, rows: Rows) -> list[Array]:
        """Return the desired poses every `HORIZON` seconds until each row's sub-goal, (k, 7).

        There is one array for each of the rows; nothing moves.
        """
        twin = self.copied()
        twin.head_start = twin.settling = twin.dwelling = np.zeros_like(self.subgoal)
        steps = np.zeros(len(rows), dtype=np.intp)
        poses, goal = [self.desired[rows]], self.goal[rows]
        while not steps.all() and len(poses) * HORIZON < LONGEST:
            step = twin.step_of(HORIZON)
            twin.desired, twin._motions.states = step.desired, step.states
            poses.append(step.desired[rows])
            metres, radians = spatial.distance(poses[-1], goal)
            there = twin.ended((metres <= GRASP_METRES) & (radians <= GOAL_RADIANS))
            steps = np.where((steps == 0) & there, len(poses), steps)
        steps[steps == 0] = len(poses)
        return [np.stack([pose[i] for pose in poses[:k]]) for i, k in enumerate(steps.tolist())]

    def begin_again(self, rows: Rows) -> None:
        """Start the motions of `rows` at their desired poses, as after a wait."""
        if rows.size:
            self._begin(rows)
            self._replan(rows)

    @cached_property
    def next_step(self) -> MotionStep:
        """Next step of the motions, of one control period."""
        return self.step_of(self._motion_time)

    def step(self, time_scale: Array) -> MotionStep:
        """Return the next step with fractions, shape (n,), of the planned motion."""
        return self.step_of(self._motion_time * time_scale)

    def step_of(self, seconds: float | Array) -> MotionStep:
        """Return the next step of some seconds, one number or shape (n,), 0 for rest.

        Generators are called, nothing moves.
        """
        frame, targets = self._to_frame(self.desired), self._target
        each = np.full(len(frame), seconds)
        resting = self.resting | (each == 0.0)
        each[resting] = 0.0
        twist, states = self._motions.twist(frame, targets, each)
        desired = preview = self._to_ee(spatial.integrate(frame, twist, seconds))
        if isinstance(seconds, np.ndarray) or seconds != HORIZON:
            preview = self._to_ee(spatial.integrate(frame, twist, HORIZON))
        if resting.any():
            desired, preview = (
                np.where(resting[:, np.newaxis], self.desired, pose) for pose in (desired, preview)
            )
        return MotionStep(desired, preview, states, each)

    def after(self, step: MotionStep, paused: NDArray[np.bool_] | None = None) -> Array:
        """Return the desired poses after a step, but for the rows that are paused, shape (n, 7)."""
        if paused is None:
            return step.desired
        return np.where(paused[:, np.newaxis], self.desired, step.desired)

    def arm_target(self, step: MotionStep, paused: NDArray[np.bool_] | None = None) -> Array:
        """Return the poses that arms aim at in a step, by `lead` ahead, shape (n, 7)."""
        after = self.after(step, paused)
        if self.lead == 0.0:
            return after
        displacement = spatial.twist_between(self.desired, after, 1.0)
        return spatial.integrate(self.desired, displacement, 1.0 + self.lead)

    def move(self, step: MotionStep, paused: NDArray[np.bool_] | None = None) -> None:
        """Carry out a step, but for the rows that are `paused`, shape (n,)."""
        self._motions.move(step.states, paused)
        self.desired = self.after(step, paused)
        passed = step.seconds if paused is None else np.where(paused, 0.0, step.seconds)
        self.elapsed = self.elapsed + passed
        self._changed()

    def advance(
        self,
        arrived: NDArray[np.bool_],
        goal_distance: Array,
        time_scale: Array,
        robots: RobotState,
        surroundings: Surroundings,
    ) -> None:
        """End a control period: replan, settle, grip, dwell, or begin the next sub-goal.

        Args:
            arrived: Whether the EE is at the end of its sub-goal, shape (n,).
            goal_distance: Its distance from there, metres, shape (n,).
            time_scale: Fraction of the planned motion that was carried out, shape (n,).
            robots: State of the robots.
            surroundings: Solids around them.
        """
        self.time_scale = time_scale
        self._replan_moving(surroundings, robots)
        subgoal, last = self.subgoal, arrived & self.last
        stops = self.end_subgoals(arrived, arrived & (goal_distance <= GRASP_METRES))
        self._grip(subgoal, stops | last)
        self.periods = self.periods + 1
        if self.stream is not None:
            rows = np.arange(len(arrived))
            self.aim(self.stream.targets(self._progress(rows, robots.base_pose)))
            self.begin_again(np.flatnonzero(time_scale == 0.0))

    def begin_next(self, rows: NDArray[np.bool_]) -> None:
        """Begin the next sub-goal of rows, shape (n,), that are not at their last one."""
        rows = rows & ~self.last
        self.subgoal = self.subgoal + rows
        self.begin_again(np.flatnonzero(rows))

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as arrays by name."""
        own = {name: getattr(self, name) for name in _ROWS}
        stream = {} if self.stream is None else self.stream.snapshot()
        targets = {f"{_STREAM}{key}": values for key, values in stream.items()}
        return own | targets | {_PATHS: self.whole_body.waypoints} | self._motions.snapshot()

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        self._put([snapshot[name].copy() for name in _ROWS])
        if self.stream is not None:
            targets = {k: values for k, values in snapshot.items() if k.startswith(_STREAM)}
            self.stream.restore({k.removeprefix(_STREAM): v for k, v in targets.items()})
        self._motions.restore(snapshot, self._which[self.subgoal])
        self._changed()
        self._solids = self.whole_body.robots = None
        self.whole_body.waypoints = snapshot[_PATHS].copy()

    def _put(self, arrays: Sequence[NDArray[Any]]) -> None:
        for name, values in zip(_ROWS, arrays, strict=True):
            setattr(self, name, values)

    def _progress(self, rows: Rows, base_pose: Array) -> Progress:
        return Progress(
            rows, self.periods, self.desired, base_pose, self.time_scale, self.dt, self._motion_time
        )

    def _replan_moving(self, surroundings: Surroundings, robots: RobotState) -> None:
        solids = surroundings.after(0.0)
        if solids is None or not self.avoids_solids:
            return
        rows, moving = _NO_ROWS, surroundings.moving
        if moving.any():
            due = self.periods % max(1, round(_REPLAN_SECONDS / self.dt)) == 0
            rows = np.flatnonzero(due & moving & (self.periods > 0))
        self.avoid(solids, rows, (robots.base_pose, robots.joint_positions))

    def end_subgoals(
        self, arrived: NDArray[np.bool_], settled: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Return whether the motion of a sub-goal but the last has just come to its end, (n,).

        `settled` is whether the EE is as near to it as a grip needs, shape (n,).
        """
        if len(self.subgoals) == 1 and not self._head_start + self._head_start_jitter:
            return np.zeros(len(self.subgoal), dtype=np.bool_)
        waits = self.settling + self.dwelling > 0
        ends = arrived & (self.head_start == 0) & ~waits & ~self.last
        moved = ends | (self.settling > 0)
        head_start = np.maximum(self.head_start - 1, 0)
        dwelling = self.dwelling - ((self.settling == 0) & (self.dwelling > 0))
        settling = np.maximum(self.settling - 1, 0)
        dwelling = np.where(ends, self._periods[self.subgoal], dwelling)
        settling = np.where(ends, self._settle_periods[self.subgoal], settling)
        settling = np.where(settled, 0, settling)
        if (waits | ends | (self.head_start > 0)).any():
            self.head_start, self.settling, self.dwelling = head_start, settling, dwelling
            self._changed()
        goes_on = (waits | ends) & (settling + dwelling == 0)
        if goes_on.any():
            self.begin_next(goes_on)
        return moved & (settling == 0)

    def _grip(self, subgoal: NDArray[np.intp], stops: NDArray[np.bool_]) -> None:
        if self._gripper is None or not stops.any():
            return
        for number, ended in enumerate(self.subgoals):
            rows = np.flatnonzero(stops & (subgoal == number))
            if ended.grip is not None and rows.size:
                self._gripper.grip(ended.grip, rows)

    def _head_starts(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.intp]:
        """Return the control periods before each row's first sub-goal; nothing is drawn in vain."""
        jitter = self._head_start_jitter
        drawn = [jitter * rng.random() if jitter else 0.0 for rng in rngs]
        each = [_periods(self._head_start + more, self.dt) for more in drawn]
        return np.array(each, dtype=np.intp)

    def _begin(self, rows: Rows) -> None:
        """Start the motion of the sub-goal that each of `rows` is at, from its desired pose."""
        self.whole_body.drop(rows)
        self.elapsed = with_rows(self.elapsed, rows, np.array(0.0))
        motions, frame, targets = self._motions, self._to_frame(self.desired), self._target
        motions.which = self._which[self.subgoal]
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
        if len(self.subgoals) == 1:
            return self._targets[:, 0]
        target: Array = self._targets[np.arange(len(self.subgoal)), self.subgoal]
        return target

    def _changed(self) -> None:
        self.revision += 1
        for name in ("goal", "next_step", "_planned"):
            vars(self).pop(name, None)

    @cached_property
    def _planned(self) -> tuple[Array, Array | None]:
        motions = [group for group in self._motions.of() if group.generator.follows_whole_body]
        return self.whole_body.soon(motions)

    def _to_frame(self, ee_pose: Array) -> Array:
        """Return the pose of the frame that each row's sub-goal moves, shape (n, 7)."""
        return spatial.compose(ee_pose, self._tool[self.subgoal]) if self._tips else ee_pose

    def _to_ee(self, frame: Array) -> Array:
        """Return the EE poses that put the moved frames at `frame`, shape (n, 7)."""
        return spatial.compose(frame, self._ee_in_tool[self.subgoal]) if self._tips else frame


def begin_motions(
    solver: IkSolver,
    subgoals: Sequence[SubgoalMotion],
    start: Start,
    rngs: Sequence[np.random.Generator],
) -> MotionSequence:
    """Return the motions of n episodes at their start, in steps of `HORIZON` and without dwells."""
    undelayed = [replace(subgoal, dwell=0.0) for subgoal in subgoals]
    sequence = MotionSequence(undelayed, solver, HORIZON)
    ee = spatial.compose(start.base_pose, forward(solver.chain, start.joint_positions))
    sequence.start(ee, start.target_poses, rngs)
    return sequence


def subgoal_ends(
    solver: IkSolver,
    subgoals: Sequence[SubgoalMotion],
    start: Start,
    rngs: Sequence[np.random.Generator],
) -> Array:
    """Return the EE poses at the ends of all sub-goals, shape (n, sub-goals, 7).

    Each sub-goal begins exactly at the end of the one before.
    """
    sequence = begin_motions(solver, subgoals, start, rngs)
    ends = []
    for _ in subgoals:
        ends.append(sequence.goal)
        sequence.desired = ends[-1]
        sequence.begin_next(np.ones(len(rngs), dtype=np.bool_))
    return np.stack(ends, axis=1)


def _periods(seconds: float, dt: float) -> int:
    # Rounding must not make 2 s of 0.1 s 21 periods.
    return math.ceil(seconds / dt - 1e-6)
