"""How well a policy does: episodes run, summed up, and set beside the ceiling."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial

from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import EpisodeRecords, Metrics, Share, join, summarize
from kinfeas.core.policy import Policy
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.episodes import BATCH, run_episodes
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import Task


class Summary(Metrics):
    """The figures of a policy, and what they are of; the ceiling is null where it is not known."""

    robot: str
    task: str
    policy: str
    seed: int
    ceiling: float | None
    ceiling_low: float | None
    ceiling_high: float | None


def evaluation_world() -> WorldConfig:
    """Return the world that policies are judged in: exact, and patient with failures."""
    return WorldConfig(max_failures=99)


@dataclass(frozen=True)
class Trial:
    """What a policy is put to.

    Attributes:
        robot: Who moves.
        task: Draws the episodes.
        episodes: How many, at least 1: numbers 0 to `episodes` - 1 of the seed.
        seed: Of all episodes.
        world: Everything else.
    """

    robot: Robot
    task: Task
    episodes: int = 500
    seed: int = 1
    world: WorldConfig = field(default_factory=evaluation_world)


@dataclass(frozen=True)
class EvaluationConfig:
    """What can be set of an evaluation beside what it evaluates.

    Attributes:
        task: Keyword parameters of the task.
        world: Where the episodes happen.
    """

    task: dict[str, object] = field(default_factory=dict)
    world: WorldConfig = field(default_factory=evaluation_world)


def evaluate(
    trial: Trial,
    policy: Policy,
    name: str = "",
    ceiling: Share | None = None,
    processes: int = 1,
    on_done: Callable[[int], None] | None = None,
) -> Summary:
    """Return the figures of a policy: shares in 0-1, distances in metres.

    Args:
        trial: What it is put to.
        policy: Moves the base.
        name: What to call it.
        ceiling: Share of the trial's goals that can be reached, as `trial_reachability` finds it;
            null in the summary by default.
        processes: How many processes share the episodes; no figure depends on it.
        on_done: Called with the number of episodes that have just ended.

    Returns:
        The figures of `metrics.summarize` with robot, task, policy, seed and the ceiling.
    """
    records = run_trial(trial, policy, processes, on_done)
    return {
        "robot": trial.robot.name,
        "task": trial.task.name,
        "policy": name,
        "seed": trial.seed,
        **summarize(records),
        "ceiling": ceiling.value if ceiling else None,
        "ceiling_low": ceiling.low if ceiling else None,
        "ceiling_high": ceiling.high if ceiling else None,
    }


def trial_reachability(trial: Trial, on_done: Callable[[float], None] | None = None) -> Share:
    """Return the share of a trial's goals that some base pose reaches."""
    found = measure_reachability(
        trial.robot, trial.task, trial.episodes, trial.seed, trial.world.ik, on_done
    )
    return found.share


def run_trial(
    trial: Trial,
    policy: Policy,
    processes: int = 1,
    on_done: Callable[[int], None] | None = None,
) -> EpisodeRecords:
    """Return what happened in each episode; arguments as in `evaluate`."""
    if processes == 1:
        world = World(trial.robot, trial.task, trial.world, trial.seed)
        return run_episodes(world, policy, trial.episodes, on_done)
    firsts = range(0, trial.episodes, BATCH)
    counts = [min(BATCH, trial.episodes - first) for first in firsts]
    parts = []
    with worker_pool(min(processes, len(firsts))) as pool:
        for part in pool.map(partial(_run_part, trial, policy), firsts, counts):
            parts.append(part)
            if on_done is not None:
                on_done(len(part.reached))
    return join(parts)


@contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool whose workers die of Ctrl-C without a word.

    Raises:
        KinfeasError: If a worker dies of anything else but an exception.
    """
    pool = ProcessPoolExecutor(
        processes,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        yield pool
    except BrokenProcessPool as error:
        raise KinfeasError(
            f"one of {processes} worker processes died, as if killed or out of memory; "
            "try fewer --processes"
        ) from error
    finally:
        pool.shutdown(cancel_futures=True)


def _run_part(trial: Trial, policy: Policy, first: int, count: int) -> EpisodeRecords:
    world = World(trial.robot, trial.task, trial.world, trial.seed)
    return run_episodes(world, policy, count, first=first)
