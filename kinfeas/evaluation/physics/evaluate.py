"""How well a policy does in the PyBullet world: the same episodes, with inertia and contacts."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Literal

import numpy as np

from kinfeas.backends.pybullet.stage import has_scene
from kinfeas.core.metrics import Metrics, Share, join, summarize, wilson
from kinfeas.core.policy import Policy
from kinfeas.evaluation.evaluate import Summary, worker_pool
from kinfeas.evaluation.physics.world import PhysicsRecords, PhysicsTrial, PhysicsWorld

_SHARES = 4  # of the episodes for each process


class PhysicsMetrics(Metrics):
    """What a number of episodes come to; a task's success is null where it cannot be done."""

    task_success: float | None
    task_success_low: float | None
    task_success_high: float | None
    base_collisions: float
    arm_collisions: float
    collision_free_rate: float


class PhysicsSummary(Summary, PhysicsMetrics):
    """The figures of a policy, and what they are of: pace as adapters, too, have made it."""

    world: Literal["pybullet"]
    time_scale: float
    head_start: float
    filters: list[str]
    objects: bool


def evaluate_physics(  # noqa: PLR0913 - as `evaluate`
    trial: PhysicsTrial,
    policy: Policy,
    name: str = "",
    ceiling: Share | None = None,
    processes: int = 1,
    on_done: Callable[[int], None] | None = None,
    *,
    gui: bool = False,
) -> PhysicsSummary:
    """Return the figures of a policy: shares in 0-1, distances in metres.

    Args:
        trial: What it is put to.
        policy: Moves the base.
        name: What to call it.
        ceiling: Share of the task's goals that some base pose reaches; null by default.
        processes: How many processes share the episodes; no figure depends on it.
        on_done: Called with the number of episodes that have just ended.
        gui: Whether to show them in a window, one after the other.

    Returns:
        The figures of `metrics.summarize` with those of tasks and collisions; without the objects
        that a task handles, its success is null.
    """
    records = run_physics(trial, policy, processes, on_done, gui=gui)
    execution = trial.execution
    return {
        "robot": trial.robot.name,
        "task": trial.task.name,
        "policy": name,
        "seed": trial.seed,
        "world": "pybullet",
        "time_scale": execution.time_scale,
        "head_start": execution.head_start,
        "filters": [one.name for one in trial.settings.filters],
        "objects": trial.settings.objects,
        **physics_figures(records, judged=is_judged(trial)),
        "ceiling": ceiling.value if ceiling else None,
        "ceiling_low": ceiling.low if ceiling else None,
        "ceiling_high": ceiling.high if ceiling else None,
    }


def is_judged(trial: PhysicsTrial) -> bool:
    """Return whether the task can be done: the objects that it handles, if any, are there."""
    return trial.settings.objects or not has_scene(trial.task)


def physics_figures(records: PhysicsRecords, *, judged: bool) -> PhysicsMetrics:
    """Return the figures of `metrics.summarize` with those of tasks and collisions.

    Args:
        records: What happened.
        judged: Whether the task could be done; if not, its success is null.
    """
    done = wilson(int(records.done.sum()), len(records.done)) if judged else None
    return {
        **summarize(records),
        "task_success": done.value if done else None,
        "task_success_low": done.low if done else None,
        "task_success_high": done.high if done else None,
        "base_collisions": float(records.base_collisions.mean()),
        "arm_collisions": float(records.arm_collisions.mean()),
        "collision_free_rate": float(
            np.mean(records.base_collisions + records.arm_collisions == 0)
        ),
    }


def run_physics(
    trial: PhysicsTrial,
    policy: Policy,
    processes: int = 1,
    on_done: Callable[[int], None] | None = None,
    *,
    gui: bool = False,
) -> PhysicsRecords:
    """Return what happened in each episode; arguments as in `evaluate_physics`."""
    if processes == 1 or gui:
        return run_part(trial, policy, range(trial.episodes), on_done, gui=gui)
    count = min(_SHARES * processes, trial.episodes)
    bounds = np.linspace(0, trial.episodes, count + 1).round().astype(int).tolist()
    shares = [range(low, high) for low, high in pairwise(bounds)]
    parts = []
    with worker_pool(min(processes, count)) as pool:
        for part in pool.map(partial(run_part, trial, policy), shares):
            parts.append(part)
            if on_done is not None:
                on_done(len(part.reached))
    return join(parts)


def run_part(
    trial: PhysicsTrial,
    policy: Policy,
    episodes: range,
    on_done: Callable[[int], None] | None = None,
    *,
    gui: bool = False,
) -> PhysicsRecords:
    """Return what happened in some episodes of a trial; other arguments as in `run_physics`."""
    world = PhysicsWorld(trial, gui=gui)
    try:
        # A window shows one robot.
        step = 1 if gui else len(episodes)
        parts = (episodes[at : at + step] for at in range(0, len(episodes), step))
        return join([world.run(policy, part, on_done) for part in parts])
    finally:
        world.close()
