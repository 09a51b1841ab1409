"""Planners in threads beside the control loop."""

import sys
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.base_path import BasePath
from kinfeas.control.filters.path_planner import PathPlanner
from kinfeas.control.filters.rollout import RolloutPlanner, Snapshot
from kinfeas.control.motion_sequence import MotionSequence
from kinfeas.control.period import Period
from kinfeas.core.motion import Rows
from kinfeas.core.policy import CommandFilter, Policy, PolicyInput
from kinfeas.core.spatial import Array

_SWITCH_INTERVAL = 1e-5
"""Seconds for which the loop may wait for Python's lock each time that a kernel has released it."""


class PlannerThread:
    """A thread for one robot, which ends with `close`."""

    _usual_interval, _threads = 0.0, 0  # of all planners
    _worker: ThreadPoolExecutor | None = None
    _coming: Future[Any] | None = None

    def open(self) -> ThreadPoolExecutor:
        """Start the thread, or start it again."""
        self.close()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="planner")
        if not PlannerThread._threads:
            PlannerThread._usual_interval = sys.getswitchinterval()
            sys.setswitchinterval(_SWITCH_INTERVAL)
        PlannerThread._threads += 1
        return self._worker

    def close(self) -> None:
        """End the thread after the current plan; further calls do nothing."""
        if self._worker is not None:
            self._worker.shutdown()
            self._worker = self._coming = None
            PlannerThread._threads -= 1
            if not PlannerThread._threads:
                sys.setswitchinterval(PlannerThread._usual_interval)


class RolloutPlannerThread(PlannerThread, RolloutPlanner):
    """Rollout planner for one robot in a thread.

    An offset is applied from when it is found. If the next plan is due before that, the offset is
    zero until there is a plan, since the last one is outdated.
    """

    def simulated_policy(self, policy: Policy) -> Policy:
        """Return a copy, since policies need not be thread-safe."""
        return deepcopy(policy)

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Start the thread; call `close` at the end."""
        super().reset(loop, rows)
        self.open()

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return the commands with the offsets; arguments as in `CommandFilter`."""
        if self._coming is not None and self._coming.done():
            self.offset, self._coming = self._coming.result(), None
        return super().__call__(command, policy_input)

    def replan(self, now: Snapshot, due: Rows) -> None:
        """Start the search for a new offset."""
        assert self._worker is not None
        if self._coming is None:
            self._coming = self._worker.submit(self.plan, now, due)
        else:
            self.offset = np.zeros_like(self.offset)


class PathPlannerThread(PlannerThread, PathPlanner):
    """Path planner for one robot in a thread; the robot rests until a path is found."""

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Start the thread; call `close` at the end."""
        super().reset(loop, rows)
        self.open()

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return the commands along the path; arguments as in `CommandFilter`."""
        along = super().__call__(command, policy_input)
        if self._coming is None:
            return along
        if self._coming.done():
            self.put(self._coming.result())
            self._coming = None
            return super().__call__(command, policy_input)
        self._loop.slow_down(np.zeros(1))
        return np.zeros_like(command)

    def search(self, rows: Rows, period: Period, sequence: MotionSequence) -> dict[int, BasePath]:
        """Start the search for a path."""
        assert self._worker is not None
        self._coming = self._worker.submit(super().search, rows, period, sequence)
        return {}


def in_threads(filters: Iterable[CommandFilter]) -> list[CommandFilter]:
    """Return filters with their planners in threads."""
    return [_in_thread(command_filter) for command_filter in filters]


def _in_thread(command_filter: CommandFilter) -> CommandFilter:
    if isinstance(command_filter, RolloutPlanner):
        settings = {
            each.name: getattr(command_filter, each.name)
            for each in fields(command_filter)
            if each.init
        }
        return RolloutPlannerThread(**settings)
    return PathPlannerThread() if isinstance(command_filter, PathPlanner) else command_filter
