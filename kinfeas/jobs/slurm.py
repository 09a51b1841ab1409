"""The engine `slurm`: jobs of a Slurm cluster, submitted by submitit."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import submitit
from submitit.core.utils import FailedJobError, UncompletedJobError
from submitit.helpers import Checkpointable, as_completed

from kinfeas.config.quantities import Count, Positive
from kinfeas.core.errors import KinfeasError
from kinfeas.jobs.job import Job


class _Run(Checkpointable):
    """A call that Slurm queues again if it is preempted or its time is over."""

    def __call__(self, job: Job) -> str | None:
        """Run a job; return the error of bad input, of which submitit would keep a traceback."""
        try:
            job.run()
        except KinfeasError as error:
            return str(error)
        return None


@dataclass(frozen=True)
class Slurm:
    """Runs jobs as an array of Slurm jobs, each on one core.

    Attributes:
        processes: Jobs at a time.
        cluster: `local` starts processes of this machine instead.
        folder: Folder of submitit's scripts, pickles and logs.
        partition: Partition; that of Slurm by default.
        minutes: Time limit of a job.
        memory_gb: Memory of a job.
        poll_seconds: Time between two looks at the queue.
    """

    processes: Count = 1
    cluster: Literal["slurm", "local"] = "slurm"
    folder: str = "runs/slurm"
    partition: str | None = None
    minutes: Count = 24 * 60
    memory_gb: Positive = 4.0
    poll_seconds: Positive = 10.0

    def __call__(self, jobs: Sequence[Job]) -> Iterator[Job]:
        """Run jobs; those not done are cancelled when this ends."""
        with _submission():
            executor = submitit.AutoExecutor(self.folder, cluster=self.cluster)
            executor.update_parameters(
                timeout_min=self.minutes,
                mem_gb=self.memory_gb,
                cpus_per_task=1,
                slurm_array_parallelism=self.processes,
                slurm_partition=self.partition,
            )
        run = _Run()  # type: ignore[no-untyped-call]
        # The local executor starts everything that is submitted at once.
        size = self.processes if self.cluster == "local" else len(jobs)
        for at in range(0, len(jobs), size):
            part = jobs[at : at + size]
            with _submission():
                tasks = dict(zip(executor.map_array(run, part), part, strict=True))
            try:
                for task in as_completed(list(tasks), poll_frequency=self.poll_seconds):
                    try:
                        error = task.result()
                    except FailedJobError:
                        raise
                    except UncompletedJobError:
                        continue  # killed
                    if error is not None:
                        raise KinfeasError(error)
                    yield tasks[task]
            finally:
                for task in tasks:
                    if not task.done():
                        task.cancel(check=False)


@contextmanager
def _submission() -> Iterator[None]:
    """Raise errors of submitit as KinfeasError, such as those of a machine without Slurm."""
    try:
        yield
    except RuntimeError as error:
        raise KinfeasError(f"engine slurm: {error}") from error
