"""Episodes run to their end, many at a time."""

from collections.abc import Callable

import numpy as np

from kinfeas.control.loop import Rows
from kinfeas.core.metrics import EpisodeRecords
from kinfeas.core.policy import Policy
from kinfeas.envs.world import Transition, World

BATCH = 256
"""Episodes side by side; no figure depends on it."""

Watch = Callable[[World, Transition, Rows, Rows], None]
"""Called after each step with the world, what happened, the live rows and their episodes."""


def run_episodes(  # noqa: PLR0913, PLR0917 - callbacks and sizes by keyword
    world: World,
    policy: Policy,
    episodes: int,
    on_done: Callable[[int], None] | None = None,
    watch: Watch | None = None,
    first: int = 0,
    batch: int = BATCH,
) -> EpisodeRecords:
    """Return what happened in episodes `first` to `first + episodes - 1` of the world's seed.

    Args:
        world: Where they happen.
        policy: Moves the base.
        episodes: How many to run.
        on_done: Called with the number of episodes that have just ended.
        watch: Called after each step, for pictures and statistics.
        first: Number of the first one.
        batch: Episodes side by side, at most; no figure depends on it.
    """
    tally = _Tally(first, episodes, len(world.task.subgoals))
    beyond = first + episodes
    running = np.arange(first, first + min(batch, episodes))
    world.loop.set_policy(policy)
    world.start(running.tolist())
    waiting = first + len(running)
    while (live := np.flatnonzero(running >= 0)).size:
        transition = world.step(policy.act(world.loop.policy_input))
        tally.add(transition, live, running[live])
        if watch is not None:
            watch(world, transition, live, running[live])
        ended = live[transition.done[live]]
        if on_done is not None and ended.size:
            on_done(ended.size)
        fresh = np.arange(waiting, min(waiting + ended.size, beyond))
        waiting += len(fresh)
        running[ended] = -1
        if fresh.size:
            rows = ended[: len(fresh)]
            running[rows] = fresh
            world.start(fresh.tolist(), rows)
    return tally.records()


class _Tally:
    """Sums over the steps of each episode."""

    def __init__(self, first: int, episodes: int, subgoals: int) -> None:
        self.first, self.last = first, subgoals - 1
        self.reached = np.zeros(episodes, dtype=np.bool_)
        self.failures, self.joint_jumps, self.steps = (
            np.zeros(episodes, dtype=np.intp) for _ in "abc"
        )
        self.deviation_sum, self.deviation_max, self.final = (np.zeros(episodes) for _ in "abc")

    def add(self, transition: Transition, rows: Rows, episodes: Rows) -> None:
        step, episodes = transition.step, episodes - self.first
        self.reached[episodes] = transition.reached[rows]
        self.failures[episodes] += ~step.feasible[rows]
        self.joint_jumps[episodes] += step.joint_jump[rows]
        self.steps[episodes] += 1
        self.deviation_sum[episodes] += step.deviation[rows]
        self.deviation_max[episodes] = np.maximum(
            self.deviation_max[episodes], step.deviation[rows]
        )
        # Whoever never came to the last sub-goal is not near its end.
        self.final[episodes] = np.where(step.subgoal == self.last, step.goal_distance, np.inf)[rows]

    def records(self) -> EpisodeRecords:
        return EpisodeRecords(
            reached=self.reached,
            failures=self.failures,
            max_deviation=self.deviation_max,
            mean_deviation=self.deviation_sum / np.maximum(self.steps, 1),
            final_distance=self.final,
            joint_jumps=self.joint_jumps,
            steps=self.steps,
        )
