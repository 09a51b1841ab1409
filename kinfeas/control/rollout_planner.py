"""The rollout planner: simulates the policy and changes commands that would lead to failures."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from kinfeas.config import Interval
from kinfeas.config.quantities import LONGEST, PositiveSeconds, Share
from kinfeas.control.loop import Loop, Rows
from kinfeas.control.observation import HORIZON
from kinfeas.core import registry
from kinfeas.core.metrics import WITHIN
from kinfeas.core.policy import Policy, PolicyInput
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolver, spread

_RESTARTS = 2
"""Of IK while it looks ahead, in place of as many as it has when it matters."""

_FEW = 8
"""Deviations that are tried first; the others only where none of them helps."""

_ROUNDING = 1e-6
"""Of a number of periods, which must not make one more of a whole one."""

_IDLE = 0.1
"""Share of the tries that are over from which on they are left out."""

_LATER = 0.99
"""Worth of a failure or a jump one period of `HORIZON` later."""

State = dict[str, NDArray[np.generic]]
"""What `Loop.kinematic_state` returns of n rows."""


@dataclass(frozen=True)
class RolloutConfig:
    """How far and how widely to look.

    Attributes:
        horizon: Of control that are tried out; a motion that is slowed down gets less far in them.
        replan_interval: Seconds between looks.
        num_samples: Deviations from the policy that are tried where it would fail; the first is
            none.
        noise_std: Their standard deviation, in units of the action.
        jump_cost: What an arm jump costs, in kinematic failures.
        deviation_cost: What a feasible step costs that leaves the EE more than 5 cm off, as pose
            tolerance allows, in kinematic failures.
    """

    horizon: Annotated[float, Interval(low=HORIZON, high=LONGEST)] = 6.0
    replan_interval: PositiveSeconds = 0.5
    num_samples: Annotated[int, Interval(low=1, high=1000)] = 32
    noise_std: Annotated[float, Interval(low=0.0, high=100.0, open_low=True)] = 0.8
    jump_cost: Share = 0.1
    deviation_cost: Share = 0.1


class RolloutPlanner:
    """Follows a policy, and deviates from it where it would fail and a deviation would not.

    Every now and then it carries the policy out in a world without dynamics or noise. Where a
    kinematic failure, an arm jump or a straying EE shows, it tries the policy plus each of the same
    few constants, and adds the one with the last and least of them until the next look. No row
    depends on the others.

    Attributes:
        policy: Whom it follows.
        rehearsed: Whom it tries out: the same.
        deviation: What is added to the policy's actions, shape (n, a).
    """

    def __init__(self, policy: Policy, rollout: RolloutConfig | None = None) -> None:
        """Wrap a policy; `watch` must follow before it acts."""
        self.policy = self.rehearsed = policy
        self.rollout = rollout or RolloutConfig()
        self.deviation: Array = np.zeros((0, 0))

    def watch(self, loop: Loop) -> None:
        """Look ahead of the motions of `loop` from now on."""
        self._loop = loop
        options = replace(loop.solver.options, restarts=_RESTARTS)
        solver = IkSolver(loop.robot, options)
        # It need not yield: what is avoided without yielding is avoided with it. Nothing stands in
        # its way there.
        execution = replace(
            loop.execution,
            arm_settle_timeout=0.0,
            feasibility_filter=False,
            min_obstacle_distance=0.0,
        )
        analytic = registry.build("kinfeas.backends", "analytic", {})
        self._twin = Loop(solver, loop.sequence.subgoals, analytic, HORIZON, execution)
        self._every = max(1, round(self.rollout.replan_interval / loop.dt))
        self._tries = _deviations(loop.action_size, self.rollout)
        self.deviation = np.zeros((0, loop.action_size))

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        action = self.policy.act(policy_input)
        if len(action) != len(self.deviation):
            self.deviation = np.zeros_like(action)
        due = np.flatnonzero(self._loop.periods % self._every == 0)
        if due.size:
            self.look(self._now(), due)
        return np.clip(action + self.deviation, -1.0, 1.0)

    def look(self, now: State, due: Rows) -> None:
        """Find new deviations for the rows that are due."""
        self.deviation[due] = self.plan(now, due)

    def plan(self, now: State, due: Rows) -> Array:
        """Return what to add to the policy's actions in the m rows that are due, shape (m, a).

        It touches nothing that the loop does.
        """
        best = np.zeros((len(due), self._loop.action_size))
        costs, at_once = self._try(now, due, best[:, np.newaxis], np.full(len(due), np.inf))
        cost, stuck = costs[:, 0], at_once[:, 0]
        # Who fails already finds a way out nearby or, as a rule, nowhere.
        everyone = np.ones_like(stuck)
        for num_samples, whom in ((self._tries[1:_FEW], everyone), (self._tries[_FEW:], ~stuck)):
            bad = np.flatnonzero(whom & (cost > 0.0))
            if not (bad.size and len(num_samples)):
                continue
            deviations = np.broadcast_to(num_samples, (len(bad), *num_samples.shape))
            costs, _ = self._try(now, due[bad], deviations, cost[bad])
            chosen = costs.argmin(axis=1)
            least = costs[np.arange(len(bad)), chosen]
            better = least < cost[bad]
            best[bad[better]], cost[bad[better]] = num_samples[chosen[better]], least[better]
        return best

    def _now(self) -> State:
        """Return the state that a loop of `HORIZON` periods goes on from, as copies."""
        loop, state = self._loop, self._loop.kinematic_state()
        away = state["waiting"] * loop.dt / HORIZON
        state["waiting"] = (np.sign(away) * np.ceil(np.abs(away) - _ROUNDING)).astype(np.intp)
        return {key: values.copy() for key, values in state.items()}

    def _try(
        self, now: State, rows: Rows, deviations: Array, limit: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return what the time ahead costs, and who fails at once, shapes (m, k).

        Args:
            now: Where all rows are.
            rows: The m rows to look ahead of.
            deviations: What is added to their actions, shape (m, k, a).
            limit: Of the cost, shape (m,): a try is not carried on beyond it.
        """
        m, k, size = deviations.shape
        twin = self._twin
        twin.restore({key: np.repeat(values[rows], k, axis=0) for key, values in now.items()})
        going, added, limit = np.arange(m * k), deviations.reshape(m * k, size), limit.repeat(k)
        cost, over = np.zeros(m * k), np.zeros(m * k, dtype=np.bool_)
        stuck = over.copy()
        for period in range(round(self.rollout.horizon / HORIZON)):
            action = self.rehearsed.act(twin.policy_input) + added[going]
            step = twin.step(np.clip(action, -1.0, 1.0))
            missing = 1.0 + step.position_error + step.rotation_error
            strays = step.position_error > WITHIN
            less = self.rollout.jump_cost * step.joint_jump + self.rollout.deviation_cost * strays
            price = np.where(step.feasible, less, missing)
            cost[going] += np.where(over, 0.0, price * _LATER**period)
            if period == 0:
                stuck = ~step.feasible
            over |= step.finished | (cost[going] > limit[going])
            if over.all():
                break
            if over.mean() >= _IDLE:
                going, state = going[~over], twin.kinematic_state()
                twin.restore({key: values[~over] for key, values in state.items()})
                over = over[~over]
        return cost.reshape(m, k), stuck.reshape(m, k)


def _deviations(size: int, rollout: RolloutConfig) -> Array:
    """Return normally distributed constants that fill the space evenly, shape (tries, size).

    The first of them is 0, the policy alone.
    """
    deviations: Array = ndtri(spread(rollout.num_samples, size)) * rollout.noise_std
    return deviations
