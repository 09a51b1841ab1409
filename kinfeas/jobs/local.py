"""The engine `local`: processes of this machine."""

from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import dataclass

from kinfeas.config.quantities import Count
from kinfeas.envs.episodes import WorkerDiedError, worker_pool
from kinfeas.jobs.job import Job


@dataclass(frozen=True)
class Local:
    """Runs jobs in worker processes; in this process if there is to be one."""

    processes: Count = 1

    def __call__(self, jobs: Sequence[Job]) -> Iterator[Job]:
        """Run jobs; a worker that dies ends the others, too."""
        if self.processes == 1:
            for job in jobs:
                job.run()
                yield job
            return
        with suppress(WorkerDiedError), worker_pool(min(self.processes, len(jobs))) as pool:
            futures = {pool.submit(job.run): job for job in jobs}
            for future in as_completed(futures):
                future.result()
                yield futures[future]
