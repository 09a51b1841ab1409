"""The engine `ray`: workers of a Ray cluster, or of a local one that begins and ends with us."""

import logging
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import ray
from ray.exceptions import RayError, RayTaskError

from kinfeas.config.quantities import Count
from kinfeas.jobs.job import ATTEMPTS, Job


@dataclass(frozen=True)
class Ray:
    """Runs jobs with Ray, each on one core.

    Attributes:
        processes: Jobs at a time in a local cluster; a running cluster has as many as cores.
        address: Of a running cluster, or `local`.
    """

    processes: Count = 1
    address: str = "local"

    def __call__(self, jobs: Sequence[Job]) -> Iterator[Job]:
        """Run jobs; Ray itself starts those of killed workers again."""
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        # Workers of a local cluster would give way to all other programs.
        os.environ.setdefault("RAY_worker_niceness", "0")
        ray.init(
            self.address,
            num_cpus=self.processes if self.address == "local" else None,
            include_dashboard=False,
            logging_level=logging.ERROR,
            log_to_driver=False,
        )
        call = ray.remote(num_cpus=1, max_retries=ATTEMPTS)(_run)
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
                    continue  # its worker or its machine has died
                yield job
        finally:
            ray.shutdown()


def _run(job: Job, folder: Path) -> None:
    os.chdir(folder)  # relative paths are the driver's
    job.run()
