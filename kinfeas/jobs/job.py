"""Jobs: a description in, one JSON file out; and engines, which run them anywhere.

Trainings, parts of a benchmark and trials of a sweep are jobs. A job can be started again at any
time: with a file it is done, a training resumes from its checkpoint, other jobs begin anew.
"""

import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinfeas import config
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.files import write_json, writing
from kinfeas.envs.episodes import WorkerDiedError, worker_pool
from kinfeas.training.config import TrainConfig
from kinfeas.training.run import EVALUATION, SETTINGS, read_evaluation

if TYPE_CHECKING:
    from kinfeas.training.train import Report

ATTEMPTS = 10
"""Times in a row that workers may die before a job is done."""

RUNNERS = ("local", "ray")

Result = dict[str, Any]
"""The content of a job's file."""


@dataclass(frozen=True)
class Job:
    """A call whose result is kept in a file."""

    # function at the top level of a module, which returns plain data
    call: Callable[[Any], Mapping[str, Any]]
    description: Any  # argument of the call; it can be pickled and determines the result
    path: Path  # JSON file of the result

    def run(self) -> None:
        """Write the result, unless it is there."""
        if not self.path.exists():
            write_json(self.call(self.description), self.path)

    def result(self) -> Result:
        """Return the result; raise KinfeasError if the file is missing or broken."""
        try:
            return dict(json.loads(self.path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError) as error:
            message = f"{self.path}: broken; remove it to compute it again"
            raise KinfeasError(message) from error


Engine = Callable[[Sequence[Job]], Iterator[Job]]
"""Runs jobs and yields each finished job; errors of a job are raised.

All machines of an engine use one file system. A job whose worker was killed may be left out:
`run_jobs` runs it again.
"""


def run_jobs(
    jobs: Sequence[Job], engine: Engine, on_done: Callable[[], None] | None = None
) -> list[Result]:
    """Return the result of each job; those with a file are not run.

    No result depends on the engine. A worker writes each result as soon as it is there, so an
    interruption loses nothing that is finished.

    Raises:
        KinfeasError: If a job is invalid, a file is broken or cannot be written, or workers die
            `ATTEMPTS` times in a row.
    """
    missing = {job.path: job for job in jobs if not job.path.exists()}
    for folder in {path.parent for path in missing}:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
    deaths = 0
    while missing:
        deaths += 1
        for job in engine(list(missing.values())):
            deaths = 0
            del missing[job.path]
            if on_done is not None:
                on_done()
        if deaths == ATTEMPTS:
            raise KinfeasError(
                f"{next(iter(missing))}: worker processes died {deaths} times in a row, as if out "
                "of memory; try fewer --processes"
            )
    return [job.result() for job in jobs]


def build_engine(name: str, processes: int = 1, address: str | None = None) -> Engine:
    """Return an engine of `RUNNERS`: `local` for processes of this machine, or `ray`.

    There are `processes` jobs at a time; a running Ray cluster, at `address`, has as many as cores.
    Without an address one begins and ends with the jobs.
    """
    if name not in RUNNERS:
        raise KinfeasError(f"unknown engine {name!r}{no_such(name, RUNNERS)}")
    if name == "ray":
        import ray  # noqa: F401 - an extra that is missing is an error before any work

        return partial(_run_on_ray, processes=processes, address=address)
    if address is not None:
        raise KinfeasError("'address' is for the engine ray")
    return partial(_run_here, processes=processes)


def _run_here(jobs: Sequence[Job], processes: int) -> Iterator[Job]:
    if processes == 1:
        for job in jobs:
            job.run()
            yield job
        return
    # If a worker dies, the pool ends the others, too.
    with suppress(WorkerDiedError), worker_pool(min(processes, len(jobs))) as pool:
        futures = {pool.submit(job.run): job for job in jobs}
        for future in as_completed(futures):
            future.result()
            yield futures[future]


def _run_on_ray(jobs: Sequence[Job], processes: int, address: str | None) -> Iterator[Job]:
    import ray
    from ray.exceptions import RayError, RayTaskError

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # By default, workers of a local cluster have a lower priority than all other programs.
    os.environ.setdefault("RAY_worker_niceness", "0")
    try:
        ray.init(
            address or "local", num_cpus=processes if address is None else None,
            include_dashboard=False, logging_level=logging.ERROR, log_to_driver=False,
        )  # fmt: skip
    except (ValueError, ConnectionError) as error:  # not an address, or no cluster there
        raise KinfeasError(f"'address' {address!r}: {error}") from error
    # Ray itself starts the jobs of killed workers again.
    call = ray.remote(num_cpus=1, max_retries=ATTEMPTS)(_run_in)
    try:
        waiting = {call.remote(job, Path.cwd()): job for job in jobs}
        while waiting:
            (done,), _ = ray.wait(list(waiting))
            job = waiting.pop(done)
            try:
                ray.get(done)
            except RayTaskError as error:
                raise error.cause from None
            except RayError:
                continue  # the job's worker or machine has died
            yield job
    finally:
        ray.shutdown()


def _run_in(job: Job, folder: Path) -> None:
    os.chdir(folder)  # relative paths are the driver's
    job.run()


def training_job(settings: TrainConfig, folder: Path) -> Job:
    """Return the job of a training run; its folder may hold this run, unfinished, but no other."""
    if (folder / SETTINGS).is_file() and config.load(TrainConfig, folder / SETTINGS) != settings:
        raise KinfeasError(f"{folder}: a run of other settings; remove it, or use another --out")
    return Job(finish_training, (settings, folder), folder / EVALUATION)


def finish_training(
    training: tuple[TrainConfig, Path], on_progress: "Report | None" = None
) -> Result:
    """Train or resume a run, given by settings and folder; return its final evaluation."""
    from kinfeas.training.train import resume, train

    settings, folder = training
    if (folder / SETTINGS).is_file():
        resume(folder, on_progress)
    else:
        train(settings, folder, on_progress)
    return read_evaluation(folder)
