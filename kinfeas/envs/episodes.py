"""Episodes run to their end, many at a time, in one process or several."""

import logging
import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing.context import SpawnContext, SpawnProcess

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.errors import PLUGIN_ERRORS, KinfeasError, describe
from kinfeas.core.metrics import EpisodeRecords, join
from kinfeas.core.motion import Rows
from kinfeas.core.policy import Policy
from kinfeas.envs.world import Transition, World
from kinfeas.tasks.task import StagedTask

BATCH, _BATCHES = 64, 4
"""Largest number of episodes side by side in a process, and of such batches that a process gets at
once. Rows of ended episodes cost time until the last one ends. No result depends on either."""

COLLISION_GAP = 0.5
"""Seconds without contact after which the next contact with a body is another collision."""

_ROUND = 2
"""Episodes of a process in a round of an evaluation with a time limit."""

Watch = Callable[[World, Transition, Rows, Rows], None]
"""Called after each step with world, transition, rows of running episodes and their numbers."""

OnDone = Callable[[int], None]
"""Called with the number of episodes that have just ended."""


_log = logging.getLogger(__name__)


class WorkerDiedError(KinfeasError):
    """A worker process died, as if killed or out of memory."""


def run_episodes(
    world: World,
    policy: Policy,
    episodes: int,
    on_done: OnDone | None = None,
    watch: Watch | None = None,
    first: int = 0,
) -> EpisodeRecords:
    """Return the records of episodes `first` to `first + episodes - 1` of the world's seed."""
    tally = _Tally(world, first, episodes)
    beyond = first + episodes
    world.loop.set_policy(policy)
    running = np.arange(first, first + min(_batch(world), episodes))
    world.start(running.tolist())
    waiting = first + len(running)
    while (live := np.flatnonzero(running >= 0)).size:
        transition = world.step()
        if watch is not None:
            watch(world, transition, live, running[live])
        tally.add(transition, live, running[live])
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


def evaluate_episodes(
    build: Callable[[], World],
    policy: Policy,
    episodes: range,
    processes: int = 1,
    on_done: OnDone | None = None,
) -> EpisodeRecords:
    """Return the records of a range of episodes, in worlds built for them.

    Several processes need a picklable `build`. Results do not depend on the number of processes.

    Raises:
        KinfeasError: If a world cannot be built, or a worker process dies.
    """
    with closed(world := build()):
        if processes == 1:
            return run_episodes(world, policy, len(episodes), on_done, first=episodes.start)
        world.loop.set_policy(policy)
        rounds = math.ceil(len(episodes) / (processes * _BATCHES * _batch(world)))
    size = math.ceil(len(episodes) / (processes * rounds))
    parts = math.ceil(len(episodes) / size)
    with worker_pool(min(processes, parts)) as pool:
        return join(_run_parts(pool, build, policy, episodes, size, on_done))


def evaluate_within(  # noqa: PLR0913, PLR0917 - an evaluation and its limits
    seconds: float,
    pool: Executor,
    processes: int,
    build: Callable[[], World],
    policy: Policy,
    episodes: range,
    on_done: OnDone | None = None,
) -> EpisodeRecords:
    """Return the records of the first episodes of a range, as many as fit into `seconds`.

    They run in rounds of a few episodes in each process of the pool; the first round always does.
    """
    end, records, size = time.monotonic() + seconds, list[EpisodeRecords](), _ROUND * processes
    for at in range(0, len(episodes), size):
        begun = time.monotonic()
        records += _run_parts(pool, build, policy, episodes[at : at + size], _ROUND, on_done)
        now = time.monotonic()
        if now + (now - begun) > end:
            break
    return join(records)


@contextmanager
def closed(world: World) -> Iterator[None]:
    """Close a world after a block; exceptions of `close` are logged, so that no result is lost."""
    try:
        yield
    finally:
        try:
            world.close()
        except PLUGIN_ERRORS as error:
            _log.error("%s could not be closed: %s", world.backend.name, describe(error))


@contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes that end silently on Ctrl-C, and with this process.

    At the end of the block they end at once, also after an exception.
    """
    pool = ProcessPoolExecutor(
        processes,
        mp_context=WorkerContext(),
        initializer=begin_worker,
        initargs=(signal.SIG_DFL,),
    )
    with workers_alive(processes):
        try:
            yield pool
        finally:
            terminate(pool)


def terminate(pool: ProcessPoolExecutor) -> None:
    """End the processes of a pool at once; work in progress is lost."""
    for worker in list((pool._processes or {}).values()):
        worker.terminate()
    pool.shutdown(cancel_futures=True)


@contextmanager
def workers_alive(processes: int) -> Iterator[None]:
    """Raise a WorkerDiedError if a worker process dies in the block."""
    try:
        yield
    except BrokenExecutor as error:
        raise WorkerDiedError(
            f"one of {processes} worker processes died, as if killed or out of memory, or at the "
            "import of a script without if __name__ == '__main__'; try fewer processes"
        ) from error


class _Worker(SpawnProcess):
    def start(self) -> None:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WorkerContext(SpawnContext):
    """Starts processes that delay Ctrl-C until `begin_worker`: their imports take seconds."""

    Process = _Worker


def begin_worker(on_interrupt: signal.Handlers) -> None:
    """Let this worker process end with its parent, and handle Ctrl-C by `on_interrupt`."""
    signal.signal(signal.SIGINT, on_interrupt)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _run_parts(
    pool: Executor,
    build: Callable[[], World],
    policy: Policy,
    episodes: range,
    size: int,
    on_done: OnDone | None,
) -> list[EpisodeRecords]:
    """Return the records of parts of `size` episodes, which the processes of a pool run."""
    parts = [episodes[at : at + size] for at in range(0, len(episodes), size)]
    records = []
    for part in pool.map(partial(evaluate_episodes, build, policy), parts):
        records.append(part)
        if on_done is not None:
            on_done(len(part.reached))
    return records


def _batch(world: World) -> int:
    parts = world.backend, *world.loop.filters
    limits = (getattr(part, "max_batch", None) for part in parts)
    return min([BATCH, *(limit for limit in limits if limit is not None)])


class _Tally:
    """Sums over the steps of each episode."""

    def __init__(self, world: World, first: int, episodes: int) -> None:
        self.world, self.first, self.last = world, first, len(world.task.subgoals) - 1
        self.reached = np.zeros(episodes, dtype=np.bool_)
        self.failures, self.joint_jumps, self.steps = np.zeros((3, episodes), dtype=np.intp)
        self.deviation_sum, self.deviation_max, self.final = np.zeros((3, episodes))
        self.response_sums = np.zeros((episodes, 2))
        self.tracking_sum, self.tracking_max = np.zeros((2, episodes))
        self.deviation_squares, self.length, self.planned_length = np.zeros((3, episodes))
        self.base, self.arm = (Collisions(episodes, world.loop.dt) for _ in range(2))
        self.task_done: list[bool | None] = [None] * episodes

    def add(self, transition: Transition, rows: Rows, episodes: Rows) -> None:
        outcome, episodes = transition.outcome, episodes - self.first
        self.reached[episodes] = transition.reached[rows]
        self.failures[episodes] += ~outcome.feasible[rows]
        self.joint_jumps[episodes] += outcome.joint_jump[rows]
        self.steps[episodes] += 1
        deviation, tracking_error = outcome.deviation[rows], outcome.tracking_error[rows]
        self.deviation_sum[episodes] += deviation
        self.deviation_max[episodes] = np.maximum(self.deviation_max[episodes], deviation)
        self.tracking_sum[episodes] += tracking_error
        self.tracking_max[episodes] = np.maximum(self.tracking_max[episodes], tracking_error)
        if (sums := self.world.loop.response_sums) is not None:
            self.response_sums[episodes] = sums[rows]
        if transition.path_length is not None and transition.planned_length is not None:
            self.deviation_squares[episodes] += deviation**2
            self.length[episodes] += transition.path_length[rows]
            self.planned_length[episodes] += transition.planned_length[rows]
        # An episode that never began the last sub-goal did not end near its goal. A stream has
        # no goal.
        stream = self.world.loop.stream is not None
        end = outcome.deviation if stream else outcome.goal_distance
        self.final[episodes] = np.where(outcome.subgoal == self.last, end, np.inf)[rows]
        if self.world.backend.contacts is not None or outcome.collision is not None:
            for row, episode in zip(rows.tolist(), episodes.tolist(), strict=True):
                self._add_collisions(outcome.collision, row, episode)
        done = transition.done[rows]
        for row, episode in zip(rows[done].tolist(), episodes[done].tolist(), strict=True):
            self.task_done[episode] = self._task_done(row, reached=bool(transition.reached[row]))

    def _add_collisions(self, collision: NDArray[np.bool_] | None, row: int, episode: int) -> None:
        base, arm = (False, False) if collision is None else collision[row].tolist()
        base_bodies, arm_bodies = {-1} if base else set(), {-1} if arm else set()
        if (sensor := self.world.backend.contacts) is not None:
            contacts = sensor.touching(row)
            # The geometric check, which ends the episode, finds a touch just before the engine.
            base_bodies = {body for _, body, _ in contacts.base} or base_bodies
            arm_bodies = {body for _, body, _ in contacts.arm}
        self.base.add(episode, base_bodies)
        self.arm.add(episode, arm_bodies)

    def _task_done(self, row: int, *, reached: bool) -> bool | None:
        loop, task = self.world.loop, self.world.task
        if not isinstance(task, StagedTask):
            return None
        joints = (loop.robots.true_state or loop.robots).joint_positions
        return task.task_done(row, joints, loop.dt, reached=reached)

    def records(self) -> EpisodeRecords:
        loop, sensor = self.world.loop, self.world.backend.contacts
        contacts = sensor is not None or loop.surroundings.after(0.0) is not None
        stream = loop.stream is not None
        steps, localised = np.maximum(self.steps, 1), loop.robots.localised is not None
        return EpisodeRecords(
            reached=self.reached,
            failures=self.failures,
            max_deviation=self.deviation_max,
            mean_deviation=self.deviation_sum / steps,
            final_distance=self.final,
            joint_jumps=self.joint_jumps,
            steps=self.steps,
            task_done=None if None in self.task_done else np.array(self.task_done, dtype=np.bool_),
            base_collisions=self.base.count if contacts else None,
            arm_collisions=self.arm.count if contacts else None,
            rms_deviation=np.sqrt(self.deviation_squares / steps) if stream else None,
            path_length=self.length if stream else None,
            target_path_length=self.planned_length if stream else None,
            response_sums=None if loop.response_sums is None else self.response_sums,
            max_tracking_error=self.tracking_max if localised else None,
            mean_tracking_error=self.tracking_sum / steps if localised else None,
        )


class Collisions:
    """Counts collisions of n episodes: contacts of one body within `COLLISION_GAP` are one.

    Attributes:
        count: Collisions of each episode, shape (n,).
    """

    def __init__(self, episodes: int, dt: float) -> None:
        """Count in control periods of `dt` seconds."""
        self.count = np.zeros(episodes, dtype=np.intp)
        self._gap = round(COLLISION_GAP / dt)
        self._periods = np.zeros(episodes, dtype=np.intp)
        self._last: dict[tuple[int, int], int] = {}

    def add(self, episode: int, bodies: set[int]) -> None:
        """Take in the bodies that are touched at the end of a control period."""
        self._periods[episode] += 1
        period = int(self._periods[episode])
        for body in bodies:
            last = self._last.get((episode, body))
            self.count[episode] += last is None or period - last > self._gap
            self._last[episode, body] = period
