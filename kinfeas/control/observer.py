"""Observations of the robots of a loop: their state, their motions and what stands around them."""

import numpy as np

from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.observation import (
    AHEAD,
    HORIZON,
    OBSERVATION,
    SCAN_TERMS,
    ObservedState,
    observe,
)
from kinfeas.control.sequence import MotionSequence
from kinfeas.control.surroundings import Surroundings
from kinfeas.core import spatial
from kinfeas.core.backend import ObstacleSensor, RobotState
from kinfeas.core.policy import Observation
from kinfeas.core.spatial import Array


class Observer:
    """Observations of n robots, each of which follows its own motion.

    Attributes:
        terms: Names of the observation terms, in order.
    """

    def __init__(
        self,
        sequence: MotionSequence,
        surroundings: Surroundings,
        obstacles: ObstacleSensor | None,
        dt: float,
        execution: ExecutionConfig,
    ) -> None:
        self.terms: tuple[str, ...] = OBSERVATION
        self._sequence, self._surroundings, self._obstacles = sequence, surroundings, obstacles
        self._dt, self._time_scale = dt, execution.time_scale
        self._base_offset: Array | None = None

    def prepare(self) -> None:
        """Compute what the motions cache until they change: goals, next step and paths."""
        _ = self._sequence.goal, self._sequence.next_step, self._sequence.planned
        if "planned_ahead" in self.terms:
            self._ahead()

    def observe(
        self, robots: RobotState, ee_in_base: Array, ee_pose: Array, previous_command: Array
    ) -> Observation:
        """Return the observation of robots.

        EE poses in the base and in the world have the shape (n, 7), the last base commands (n, a).
        """
        sequence, base_pose = self._sequence, robots.base_pose
        preview = planned = sequence.next_step.preview
        state = ObservedState(base_pose, ee_in_base, preview, sequence.goal, robots.joint_positions)
        state.previous_command = previous_command
        if not SCAN_TERMS.isdisjoint(self.terms):
            state.ranges = self._surroundings.ranges(len(base_pose))
        if "planned_ahead" in self.terms:
            ahead = spatial.relative(self._ahead(), base_pose[:, np.newaxis])
            state.ahead = ahead[:, :, :3].reshape(len(base_pose), -1)
        self._base_offset = None
        if "planned_base" in self.terms:
            self._base_offset = spatial.planar_offset(sequence.planned.base_pose, base_pose)
        state.planned_base = self._base_offset
        if self._time_scale != 1.0:
            twist = spatial.twist_between(sequence.desired, preview, HORIZON)
            planned = spatial.integrate(sequence.desired, twist, HORIZON * self._time_scale)
        return Observation(
            values=observe(state, self.terms),
            base_pose=base_pose, ee_pose=ee_pose, joint_positions=robots.joint_positions,
            desired=sequence.desired, planned=planned,
            demonstrated_base=sequence.demonstrated_base, planned_base=sequence.planned.base_pose,
            dt=self._dt, obstacles=self._obstacles,
        )  # fmt: skip

    def _ahead(self) -> Array:
        sequence = self._sequence
        return sequence.until_changed("ahead", lambda: sequence.ahead(AHEAD))

    @property
    def base_error(self) -> Array | None:
        """Distances of the bases from the planned ones, metres, shape (n,).

        A radian counts as half a metre. 0 without a planned base; None unless a term observes it.
        """
        if self._base_offset is None:
            return None
        x, y, angle = self._base_offset.T
        return np.hypot(x, y) + 0.5 * np.abs(angle)
