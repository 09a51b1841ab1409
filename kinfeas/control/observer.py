"""Observations of the robots of a loop: their state, their motions and what stands around them."""

import numpy as np

from kinfeas.control.motion_sequence import MotionSequence, Plan
from kinfeas.control.observation import (
    AHEAD,
    HORIZON,
    OBSERVATION,
    SCAN_TERMS,
    Seen,
    observe,
)
from kinfeas.control.obstacles import Obstacles
from kinfeas.core import spatial
from kinfeas.core.spatial import Array


class Observer:
    """Observations of n robots, each of which follows its own motion.

    Attributes:
        terms: Names of the observation terms, in order.
        plan: Next step of the motions.
        planned: Desired world pose of the EE in `HORIZON` seconds, shape (n, 7).
    """

    plan: Plan
    planned: Array
    _goal: Array

    def __init__(
        self, sequence: MotionSequence, obstacles: Obstacles, dt: float, time_scale: float
    ) -> None:
        """Observe a sequence that is carried out in periods of `dt` seconds, slower by a scale."""
        self.terms: tuple[str, ...] = OBSERVATION
        self._sequence, self._obstacles = sequence, obstacles
        self._motion_time, self._time_scale = dt * time_scale, time_scale
        self._revision = -1
        self._ahead: Array | None = None
        self._planned_base: Array | None = None
        self._base_seen: Array | None = None

    def prepare(self) -> None:
        """Ask the motions for their next step and goals, once after each change."""
        sequence = self._sequence
        if self._revision == sequence.revision:
            return
        self._goal, self.plan = sequence.goal, sequence.plan(self._motion_time)
        self._ahead = sequence.ahead(AHEAD) if "planned_ahead" in self.terms else None
        self._planned_base = sequence.planned_base if "planned_base" in self.terms else None
        self._revision = sequence.revision

    def observe(
        self, base_pose: Array, ee_in_base: Array, joints: Array, previous_command: Array
    ) -> Array:
        """Return the observation of robots at world poses of the bases, shape (n, d).

        EE poses have the shape (n, 7), arm joints (n, j), the last base commands (n, c).
        """
        self.prepare()
        sequence, preview = self._sequence, self.plan.preview
        seen = Seen(base_pose, ee_in_base, preview, self._goal, joints)
        seen.previous_command = previous_command
        if not SCAN_TERMS.isdisjoint(self.terms):
            seen.ranges = self._obstacles.scan()
        if self._ahead is not None:
            ahead = spatial.relative(self._ahead, base_pose[:, np.newaxis])
            seen.ahead = ahead[:, :, :3].reshape(len(base_pose), -1)
        planned = self._planned_base
        self._base_seen = None if planned is None else spatial.planar_offset(planned, base_pose)
        seen.planned_base = self._base_seen
        self.planned = preview
        if self._time_scale != 1.0:
            twist = spatial.twist_between(sequence.desired, preview, HORIZON)
            self.planned = spatial.integrate(sequence.desired, twist, HORIZON * self._time_scale)
        return observe(seen, self.terms)

    @property
    def base_error(self) -> Array | None:
        """Distances of the bases from the planned ones, metres, shape (n,).

        Half a metre for each radian; 0 without a planned base. None unless a term observes it.
        """
        if self._base_seen is None:
            return None
        x, y, angle = self._base_seen.T
        return np.hypot(x, y) + 0.5 * np.abs(angle)
