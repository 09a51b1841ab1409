"""The cells of a benchmark: each computed once, written at once, and found again after a stop."""

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.benchmark.identity import identities
from kinfeas.benchmark.job import CEILING, Job
from kinfeas.benchmark.records import to_lists
from kinfeas.benchmark.samples import WorkspaceSamples
from kinfeas.core.errors import KinfeasError
from kinfeas.core.metrics import summarize
from kinfeas.envs.episodes import run_episodes, worker_pool
from kinfeas.envs.world import World
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.io.files import write_file, writing
from kinfeas.policies.loading import BASELINES, load_policy
from kinfeas.policies.network import Network
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import Task

Result = dict[str, Any]

_CEILING_FIGURES = ("success", "low", "high")

_FIGURES = (
    "episodes", "success", "within_5cm", "ik_failures_per_episode", "mean_deviation_m",
    "joint_jumps_per_episode", "mean_steps",
)  # fmt: skip
"""Of a policy, those that tables and pictures show."""


def run_jobs(
    jobs: Sequence[Job],
    folder: Path,
    processes: int = 1,
    on_done: Callable[[Job], None] | None = None,
) -> list[Result]:
    """Return what each job found; those found before are read from `folder`.

    Args:
        jobs: What to find.
        folder: Where results are kept, each written as soon as it is there.
        processes: How many processes share the work; no result depends on it.
        on_done: Called with each job that is done.

    Raises:
        KinfeasError: If a job's input is wrong, a result cannot be written or a worker dies.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    whole = identities(jobs)
    paths = [folder / f"{job.name}-{_key(one)}.json" for job, one in zip(jobs, whole, strict=True)]
    found = [_stored(path, job, one) for path, job, one in zip(paths, jobs, whole, strict=True)]

    def keep(index: int, result: Result) -> None:
        _write(paths[index], {"identity": whole[index], **result})
        found[index] = result
        if on_done is not None:
            on_done(jobs[index])

    missing = [index for index, result in enumerate(found) if result is None]
    check_baselines([jobs[index] for index in missing])
    if on_done is not None:
        for index in sorted(set(range(len(jobs))) - set(missing)):
            on_done(jobs[index])
    if processes == 1 or len(missing) < 2:
        for index in missing:
            keep(index, compute(jobs[index]))
    else:
        with worker_pool(min(processes, len(missing))) as pool:
            futures = {pool.submit(compute, jobs[index]): index for index in missing}
            for future in as_completed(futures):
                keep(futures[future], future.result())
    return [result for result in found if result is not None]


def check_baselines(jobs: Sequence[Job]) -> None:
    """Build the baselines of jobs: what one of them lacks is told before hours of work.

    Raises:
        KinfeasError: If one of them needs what is not installed, or does not suit its robot.
    """
    for source, robot in dict.fromkeys((job.source, job.robot) for job in jobs):
        if source in BASELINES:
            load_policy(source, load_robot(robot))


def compute(job: Job) -> Result:
    """Return what a job finds: its figures, and for a learned policy samples of the workspace."""
    robot, task = load_robot(job.robot), load_task(job.task, job.parameters)
    if job.physical:
        return _compute_part(job, robot, task)
    if job.policy == CEILING:
        ceiling = measure_reachability(robot, task, job.episodes, job.seed, job.world.ik)
        share = ceiling.share
        return {"figures": {"success": share.value, "low": share.low, "high": share.high}}
    policy = load_policy(job.source, robot)
    world = World(robot, task, job.world, job.seed)
    samples = WorkspaceSamples() if isinstance(policy, Network) else None
    records = run_episodes(world, policy, job.episodes, watch=samples)
    result: Result = {"figures": summarize(records)}
    return result if samples is None else {**result, "workspace": samples.kept()}


def _compute_part(job: Job, robot: Robot, task: Task) -> Result:
    """Return what happened in each episode of a part, and what these alone come to."""
    world = World(robot, task, job.world, job.seed)
    try:
        policy = load_policy(job.source, robot)
        records = run_episodes(world, policy, job.episodes, first=job.first)
    finally:
        world.close()
    return {"figures": summarize(records), "records": to_lists(records)}


def _stored(path: Path, job: Job, wanted: dict[str, Any]) -> Result | None:
    """Return the result that a file holds, or None if there is none of this identity."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        if held.pop("identity") != json.loads(json.dumps(wanted)):
            return None
        _check(job, held)
        return held
    except FileNotFoundError:
        return None
    except (OSError, ValueError, LookupError, AttributeError, TypeError) as error:
        raise KinfeasError(f"{path}: broken; remove it to have it computed again") from error


def _check(job: Job, held: Result) -> None:
    """Raise an error of some kind if a result lacks anything that a job of its kind finds."""
    for key in _CEILING_FIGURES if job.policy == CEILING else _FIGURES:
        float(held["figures"][key])
    if job.physical:
        for name, values in held["records"].items():
            if len(values) != job.episodes:
                raise ValueError(name)
    elif "workspace" in held:
        for kind in ("feasible", "infeasible"):
            np.reshape(np.array(held["workspace"][kind], dtype=float), (-1, 3))


def _write(path: Path, result: Result) -> None:
    write_file(path, json.dumps(result, allow_nan=False).encode())


def _key(whole: dict[str, Any]) -> str:
    text = json.dumps(whole, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:12]
