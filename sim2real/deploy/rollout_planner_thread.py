"""Looking ahead beside the control loop, which must not wait for it."""

import sys
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy

import numpy as np

from kinfeas.control.loop import Loop
from kinfeas.control.rollout_planner import RolloutConfig, RolloutPlanner, State
from kinfeas.core.policy import Policy, PolicyInput
from kinfeas.core.rows import Rows
from kinfeas.core.spatial import Array

_TURN = 5e-4
"""Seconds."""


class RolloutPlannerThread(RolloutPlanner):
    """Looks ahead of one robot in a thread of its own.

    What it finds holds from when it is found. Where the next look is due before that, the policy
    acts alone until there is an answer, for by then the last one is of the past.
    """

    def __init__(self, policy: Policy, rollout: RolloutConfig | None = None) -> None:
        """Wrap a policy; `watch` must follow before it acts."""
        super().__init__(policy, rollout)
        # Policies need not bear to be asked by two threads at a time.
        self.rehearsed = deepcopy(policy)
        self._worker: ThreadPoolExecutor | None = None
        self._coming: Future[Array] | None = None
        self._interval = _TURN

    def watch(self, loop: Loop) -> None:
        """Look ahead of the motion of `loop`, of one robot, from now on until `close`."""
        self.close()
        super().watch(loop)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="rollout_planner")
        self._interval = sys.getswitchinterval()
        # Python gives a thread 5 ms before it is another one's turn, a quarter of a period.
        sys.setswitchinterval(_TURN)

    def close(self) -> None:
        """End the thread after the look under way; it may be called twice.

        The interpreter's switch interval becomes again what it was before `watch`.
        """
        if self._worker is not None:
            self._worker.shutdown()
            self._worker = self._coming = None
            sys.setswitchinterval(self._interval)

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (1, 3) or (1, 2)."""
        if self._coming is not None and self._coming.done():
            self.deviation, self._coming = self._coming.result(), None
        return super().act(policy_input)

    def look(self, now: State, due: Rows) -> None:
        """Begin to look for a new deviation."""
        assert self._worker is not None
        if self._coming is None:
            self._coming = self._worker.submit(self.plan, now, due)
        else:
            self.deviation = np.zeros_like(self.deviation)
