"""Motion sequences of n EEs in time: head start, grips, dwells and targets that move."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.execution import GRASP_METRES, ExecutionConfig, SubgoalMotion
from kinfeas.control.subgoal_motions import MotionStep, SubgoalMotions
from kinfeas.control.surroundings import Surroundings
from kinfeas.control.targets import StreamProgress, TargetStream
from kinfeas.core import spatial
from kinfeas.core.backend import Gripper, RobotState
from kinfeas.core.motion import Rngs, Rows
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolver

_STREAM = "target_stream."

_REPLAN_SECONDS = 1.0  # control time between plans around moving solids


class MotionSequence(SubgoalMotions):
    """Motions in control periods: each row begins its sub-goals at times of its own.

    Attributes:
        head_start: Control periods until each row begins the first sub-goal, shape (n,).
        settling: Remaining control periods of settling at the end of a sub-goal, shape (n,).
        dwelling: Control periods from then until the next sub-goal begins, shape (n,).
        periods: Control periods since the start of each row, shape (n,).
        time_scale: Fraction of the planned motion that the last period carried out, shape (n,).
        stream: Targets that move; then no sub-goal ends. None for those of the start.
        lead: Periods by which arms aim ahead of the desired motion, since they lag.
        delay: Seconds until a command takes effect: base poses are predicted for that time.
    """

    TIMES = ("head_start", "settling", "dwelling", "periods", "time_scale")
    ROWS = (*SubgoalMotions.ROWS, *TIMES)

    head_start: NDArray[np.intp]
    settling: NDArray[np.intp]
    dwelling: NDArray[np.intp]
    periods: NDArray[np.intp]
    time_scale: Array

    def __init__(
        self,
        subgoals: Sequence[SubgoalMotion],
        solver: IkSolver,
        dt: float,
        execution: ExecutionConfig,
        gripper: Gripper | None = None,
        stream: TargetStream | None = None,
    ) -> None:
        super().__init__(subgoals, solver, dt, execution.time_scale)
        self.dt, self._motion_time, self._execution = dt, dt * execution.time_scale, execution
        self.stream, self._gripper, self.lead, self.delay = stream, gripper, 0.0, 0.0
        settle = _periods(execution.grasp_settle_time / execution.time_scale, dt)
        self._dwell_periods = np.array([_periods(subgoal.dwell, dt) for subgoal in subgoals])
        self._settle_periods = np.array([settle if subgoal.grip else 0 for subgoal in subgoals])

    def start(self, ee_pose: Array, targets: Array, rngs: Rngs, rows: Rows | None = None) -> None:
        """Begin the first sub-goal, as `SubgoalMotions.start` does, after the head start."""
        super().start(ee_pose, targets, rngs, rows)
        least, jitter = self._execution.head_start, self._execution.head_start_jitter
        extras = [jitter * rng.random() if jitter else 0.0 for rng in rngs]  # no unused draws
        head_start = np.array([_periods(least + extra, self.dt) for extra in extras], dtype=np.intp)
        zeros = np.zeros(len(rngs), dtype=np.intp)
        times = head_start, zeros, zeros, zeros, np.ones(len(rngs))
        self._put(dict(zip(self.TIMES, times, strict=True)), rows)

    def start_stream(self, rngs: Rngs, rows: Rows, base: Array) -> None:
        """Begin the stream of targets in m rows, if there is one; `base` has all n rows, (n, 7)."""
        if self.stream is not None:
            self.stream.start(self.desired, rngs, rows)
            self.aim(self.stream.targets(self._progress(rows, base)))

    @property
    def resting(self) -> NDArray[np.bool_]:
        """Whether each row's desired pose rests now, shape (n,)."""
        return (self.head_start > 0) | ((self.settling == 0) & (self.dwelling > 0))

    @property
    def clock(self) -> Array:
        """Motion time of each row, shape (n,), seconds; negative in its head start."""
        return self.elapsed - self._motion_time * self.head_start

    def clock_after(self, seconds: Array) -> Array:
        """Return `clock` after a period in which motions advance by some seconds, shape (n,)."""
        clock: Array = self.clock + np.where(self.head_start > 0, self._motion_time, seconds)
        return clock

    @property
    def next_step(self) -> MotionStep:
        """Next step of the motions, of one control period."""
        return self.until_changed("next_step", lambda: self.step_of(self._motion_time))

    def step(self, time_scale: Array) -> MotionStep:
        """Return the next step with fractions, shape (n,), of the planned motion."""
        return self.step_of(self._motion_time * time_scale)

    def step_of(self, seconds: float | Array) -> MotionStep:
        """Return the next step, as `SubgoalMotions.step_of` does; 0 seconds in rows that rest."""
        resting = self.resting
        return super().step_of(np.where(resting, 0.0, seconds) if resting.any() else seconds)

    def ended(self, near: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which rows are at the end of their motion, shape (n,); none with a stream."""
        return np.zeros_like(near) if self.stream is not None else super().ended(near)

    def arm_target(self, step: MotionStep, paused: NDArray[np.bool_] | None = None) -> Array:
        """Return the poses that arms aim at in a step, `lead` periods ahead, shape (n, 7)."""
        after = self.after(step, paused)
        if self.lead == 0.0:
            return after
        displacement = spatial.twist_between(self.desired, after, 1.0)
        return spatial.integrate(self.desired, displacement, 1.0 + self.lead)

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

    def end_subgoals(
        self, arrived: NDArray[np.bool_], settled: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Count down head starts, settling and dwells, and begin the sub-goals that are due.

        Return which rows have just ended the motion of a sub-goal, except the last one, and have
        settled, shape (n,). `settled` is whether the EE is as near to its end as a grip needs.
        """
        execution = self._execution
        if len(self.subgoals) == 1 and not execution.head_start + execution.head_start_jitter:
            return np.zeros(len(self.subgoal), dtype=np.bool_)
        waits = self.settling + self.dwelling > 0
        ends = arrived & (self.head_start == 0) & ~waits & ~self.last
        moved = ends | (self.settling > 0)
        head_start = np.maximum(self.head_start - 1, 0)
        dwelling = self.dwelling - ((self.settling == 0) & (self.dwelling > 0))
        settling = np.maximum(self.settling - 1, 0)
        dwelling = np.where(ends, self._dwell_periods[self.subgoal], dwelling)
        settling = np.where(ends, self._settle_periods[self.subgoal], settling)
        settling = np.where(settled, 0, settling)
        if (waits | ends | (self.head_start > 0)).any():
            self.head_start, self.settling, self.dwelling = head_start, settling, dwelling
            self._changed()
        goes_on = (waits | ends) & (settling + dwelling == 0)
        if goes_on.any():
            self.begin_next(goes_on)
        return moved & (settling == 0)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as arrays by name."""
        stream = {} if self.stream is None else self.stream.snapshot()
        return super().snapshot() | {f"{_STREAM}{key}": values for key, values in stream.items()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state that `snapshot` returned."""
        if self.stream is not None:
            targets = {k: values for k, values in snapshot.items() if k.startswith(_STREAM)}
            self.stream.restore({k.removeprefix(_STREAM): v for k, v in targets.items()})
        super().restore(snapshot)

    def _progress(self, rows: Rows, base_pose: Array) -> StreamProgress:
        return StreamProgress(
            rows, self.periods, self.desired, base_pose, self.time_scale, self.dt,
            self._motion_time, self.delay,
        )  # fmt: skip

    def _replan_moving(self, surroundings: Surroundings, robots: RobotState) -> None:
        solids = surroundings.after(0.0)
        if solids is None or not self.avoids_solids:
            return
        due = self.periods % max(1, round(_REPLAN_SECONDS / self.dt)) == 0
        rows = np.flatnonzero(due & surroundings.moving & (self.periods > 0))
        self.avoid(solids, rows, (robots.base_pose, robots.joint_positions))

    def _grip(self, subgoal: NDArray[np.intp], stops: NDArray[np.bool_]) -> None:
        if self._gripper is None or not stops.any():
            return
        for number, ended in enumerate(self.subgoals):
            rows = np.flatnonzero(stops & (subgoal == number))
            if ended.grip is not None and rows.size:
                self._gripper.grip(ended.grip, rows)


def _periods(seconds: float, dt: float) -> int:
    # Rounding must not make 21 periods of 0.1 s out of 2 s.
    return math.ceil(seconds / dt - 1e-6)
