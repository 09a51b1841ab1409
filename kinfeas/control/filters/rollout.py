"""The rollout planner: simulates the policy and changes commands that would lead to failures."""

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray
from scipy.special import ndtri

from kinfeas.config.quantities import LONGEST, PositiveSeconds, Share
from kinfeas.control.loop import Loop
from kinfeas.control.observation import HORIZON
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import WITHIN
from kinfeas.core.motion import Rows, with_rows
from kinfeas.core.policy import Policy, PolicyInput, RecurrentPolicy
from kinfeas.core.spatial import Array
from kinfeas.kinematics.ik import IkSolver, spread

_RESTARTS = 2
"""Restarts of IK in rollouts; the loop itself uses more."""

_FEW = 8
"""Samples of the first round; the second round simulates the others where none of them helps."""

_ROUNDING = 1e-6
"""Rounding error of a number of periods, so that it adds no period to a whole number."""

_FINISHED = 0.1
"""Share of finished rollouts from which on they are dropped from the batch."""

_DISCOUNT = 0.99
"""Discount of the cost for each period of `HORIZON`."""

Snapshot = dict[str, NDArray[np.generic]]
"""Result of `Loop.kinematic_state` for n rows."""


@dataclass(eq=False)
class RolloutPlanner:
    """Rolls the policy out and changes commands if it predicts failures, jumps or deviations.

    Failures are those of IK and collisions of the base.

    Every `replan_interval` seconds it simulates the policy without dynamics and noise. If the
    rollout has a cost, it simulates the policy plus each of the same few constant offsets and
    applies the offset of least cost until the next plan. No row depends on the others.

    Attributes:
        horizon: Seconds of control in a rollout.
        replan_interval: Seconds between plans.
        num_samples: Offsets that are simulated where the policy has a cost; the first is zero.
        noise_std: Standard deviation of the offsets, in units of the action.
        jump_cost: Cost of a joint jump; a failure costs 1.
        deviation_cost: Cost of a feasible step with more than 5 cm deviation.
        offset: Sum that is added to the commands now, shape (n, a).
    """

    horizon: Annotated[float, Interval(ge=HORIZON, le=LONGEST)] = 6.0
    replan_interval: PositiveSeconds = 0.5
    num_samples: Annotated[int, Interval(ge=1, le=1000)] = 32
    noise_std: Annotated[float, Interval(gt=0.0, le=100.0)] = 0.8
    jump_cost: Share = 0.1
    deviation_cost: Share = 0.1
    offset: Array = field(default_factory=lambda: np.zeros((0, 0)), init=False)
    _loop: Any = field(default=None, init=False, repr=False)
    _known: Policy | None = field(default=None, init=False, repr=False)

    def reset(self, loop: Loop, rows: NDArray[np.intp]) -> None:
        """Plan for the motions of a loop; arguments as in `CommandFilter`."""
        if loop.policy is None or isinstance(loop.policy, RecurrentPolicy):
            raise KinfeasError("the filter rollout_planner needs a policy without a state")
        if loop is not self._loop or loop.policy is not self._known:
            self._connect(loop, loop.policy)
        if len(loop.desired) != len(self.offset):
            self.offset = np.zeros((len(loop.desired), loop.command_size))
        self.offset = with_rows(self.offset, rows, np.array(0.0))

    def __call__(self, command: Array, policy_input: PolicyInput) -> Array:
        """Return the commands with the offsets; arguments as in `CommandFilter`."""
        due = np.flatnonzero(self._loop.periods % self._every == 0)
        if due.size:
            self.replan(self._now(), due)
        return np.clip(command + self.offset, -1.0, 1.0)

    def replan(self, now: Snapshot, due: Rows) -> None:
        """Find new offsets for the rows that are due."""
        self.offset[due] = self.plan(now, due)

    def plan(self, now: Snapshot, due: Rows) -> Array:
        """Return the offsets of least cost for m rows, shape (m, a); the loop is not touched."""
        best = np.zeros((len(due), self._loop.command_size))
        costs, fails = self._rollout(now, due, best[:, np.newaxis], np.full(len(due), np.inf))
        cost, stuck = costs[:, 0], fails[:, 0]
        # A row that fails now is helped by a nearby sample or, in most cases, by none.
        everyone = np.ones_like(stuck)
        for samples, chosen in ((self._samples[1:_FEW], everyone), (self._samples[_FEW:], ~stuck)):
            bad = np.flatnonzero(chosen & (cost > 0.0))
            if not (bad.size and len(samples)):
                continue
            offsets = np.broadcast_to(samples, (len(bad), *samples.shape))
            costs, _ = self._rollout(now, due[bad], offsets, cost[bad])
            winner = costs.argmin(axis=1)
            least = costs[np.arange(len(bad)), winner]
            better = least < cost[bad]
            best[bad[better]], cost[bad[better]] = samples[winner[better]], least[better]
        return best

    def simulated_policy(self, policy: Policy) -> Policy:
        """Return the policy that is called in rollouts."""
        return policy

    def _connect(self, loop: Loop, policy: Policy) -> None:
        """Build the simulated loop: without physics, filters and pauses."""
        self._loop, self._known = loop, policy
        solver = IkSolver(loop.robot, replace(loop.solver.options, restarts=_RESTARTS))
        execution = replace(loop.execution, arm_settle_timeout=0.0)
        analytic = registry.build("kinfeas.backends", "analytic", {})
        self._twin = Loop(solver, loop.sequence.subgoals, analytic, HORIZON, execution)
        self._twin.sequence.whole_body.planner = None  # plans take longer than rollouts
        self._policy = self.simulated_policy(policy)
        self._twin.set_policy(self._policy)
        self._every = max(1, round(self.replan_interval / loop.dt))
        # Normally distributed and evenly spread; the first is zero, the policy alone.
        self._samples = ndtri(spread(self.num_samples, loop.command_size)) * self.noise_std
        self.offset = np.zeros((0, loop.command_size))

    def _now(self) -> Snapshot:
        """Return a copy of the state in control periods of `HORIZON`."""
        loop, state = self._loop, self._loop.kinematic_state()
        away = state["waiting"] * loop.dt / HORIZON
        state["waiting"] = (np.sign(away) * np.ceil(np.abs(away) - _ROUNDING)).astype(np.intp)
        return {key: values.copy() for key, values in state.items()}

    def _rollout(
        self, now: Snapshot, rows: Rows, offsets: Array, limit: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the cost of rollouts, and which fail in the first period, shapes (m, k).

        Args:
            now: State of all rows.
            rows: The m rows to simulate.
            offsets: Added to their actions, shape (m, k, a).
            limit: Costs beyond which a rollout is aborted, shape (m,).
        """
        m, k, size = offsets.shape
        twin = self._twin
        twin.restore({key: np.repeat(values[rows], k, axis=0) for key, values in now.items()})
        going, added, limit = np.arange(m * k), offsets.reshape(m * k, size), limit.repeat(k)
        cost, over = np.zeros(m * k), np.zeros(m * k, dtype=np.bool_)
        stuck = over.copy()
        for period in range(round(self.horizon / HORIZON)):
            action = np.array(self._policy.act(twin.policy_input))
            action[:, :size] += added[going]
            step = twin.step(np.clip(action, -1.0, 1.0))
            clean = step.feasible
            if step.collision is not None:
                clean = clean & ~step.collision[:, 0]
            failure = 1.0 + step.position_error + step.rotation_error
            deviates = step.position_error > WITHIN
            less = self.jump_cost * step.joint_jump + self.deviation_cost * deviates
            price = np.where(clean, less, failure)
            cost[going] += np.where(over, 0.0, price * _DISCOUNT**period)
            if period == 0:
                stuck = ~step.feasible
            over |= step.finished | (cost[going] > limit[going])
            if over.all():
                break
            if over.mean() >= _FINISHED:
                going, state = going[~over], twin.kinematic_state()
                twin.restore({key: values[~over] for key, values in state.items()})
                over = over[~over]
        return cost.reshape(m, k), stuck.reshape(m, k)
