"""The rollout planner in a thread beside the control loop."""

import sys
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.control.filters.rollout import RolloutPlanner, State
from kinfeas.core.motion import Rows
from kinfeas.core.policy import Policy, PolicyInput
from kinfeas.core.spatial import Array

_SWITCH_INTERVAL = 5e-4
"""Seconds. Python's default, 5 ms, is a quarter of a control period."""


class RolloutPlannerThread(RolloutPlanner):
    """Plans for one robot in a thread.

    An offset is applied from when it is found. If the next plan is due before that, the offset is
    zero until there is a plan, since the last one is outdated.
    """

    _worker: ThreadPoolExecutor | None = None
    _coming: Future[Array] | None = None
    _interval = _SWITCH_INTERVAL

    @classmethod
    def of(cls, planner: RolloutPlanner) -> "RolloutPlannerThread":
        """Return a planner with the settings of another one."""
        return cls(**{one.name: getattr(planner, one.name) for one in fields(planner) if one.init})

    def simulated_policy(self, policy: Policy) -> Policy:
        """Return a copy, since policies need not be thread-safe."""
        return deepcopy(policy)

    def reset(self, loop: Any, rows: NDArray[np.intp]) -> None:
        """Start the thread; call `close` at the end."""
        self.close()
        super().reset(loop, rows)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="rollout_planner")
        self._interval = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL)

    def close(self) -> None:
        """End the thread after the current plan; further calls do nothing."""
        if self._worker is not None:
            self._worker.shutdown()
            self._worker = self._coming = None
            sys.setswitchinterval(self._interval)

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return the commands with the offsets; arguments as in `CommandFilter`."""
        if self._coming is not None and self._coming.done():
            self.offset, self._coming = self._coming.result(), None
        return super().__call__(command, policy_input)

    def replan(self, now: State, due: Rows) -> None:
        """Start the search for a new offset."""
        assert self._worker is not None
        if self._coming is None:
            self._coming = self._worker.submit(self.plan, now, due)
        else:
            self.offset = np.zeros_like(self.offset)
