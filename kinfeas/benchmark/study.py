"""The stages of a benchmark: it is planned, trained and evaluated, in one or several worlds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinfeas.benchmark.config import BenchmarkConfig, read_benchmark, restricted
from kinfeas.benchmark.evaluations import Evaluation, check_baselines, plan_evaluations
from kinfeas.benchmark.runs import Run, find_runs, plan_runs, read_run
from kinfeas.config import Settings
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require
from kinfeas.jobs.job import Job, Result

RunJobs = Callable[[Sequence[Job], str], list[Result]]
"""Returns the results of jobs of a kind, such as `trainings`."""


@dataclass(frozen=True)
class Study:
    """A benchmark in some worlds.

    Attributes:
        benchmark: Configuration in the first world.
        worlds: Backends of the evaluations.
        out: Folder of the results.
        runs: Training runs whose policies are evaluated.
        trainings: Those that are to be trained before, unless they are there.
    """

    benchmark: BenchmarkConfig
    worlds: tuple[str, ...]
    out: Path
    runs: list[Run]
    trainings: list[Job]

    def trained(self, run_jobs: RunJobs) -> "Study":
        """Return the study with all training runs."""
        if not self.trainings:
            return self
        run_jobs(self.trainings, "trainings")
        return replace(self, runs=[read_run(job.path.parent) for job in self.trainings])

    def evaluated(self, run_jobs: RunJobs) -> list[tuple[Evaluation, Result]]:
        """Return the evaluations in all worlds with their results."""
        plans = [
            plan_evaluations(replace(self.benchmark, backend=world), self.runs)
            for world in self.worlds
        ]
        # Engines have the same references.
        unique = {(case.name, case.row, case.variant): case for cases in plans for case in cases}
        jobs = [case.job(self.out / "results") for case in unique.values()]
        return list(zip(unique.values(), run_jobs(jobs, "evaluations"), strict=True))


def plan_study(
    name: str, settings: Settings, worlds: Sequence[str], folders: Sequence[Path], out: Path
) -> Study:
    """Return a benchmark, with the training runs of some folders in place of its own if any.

    Raises:
        KinfeasError: If the benchmark or a run is invalid, the benchmark is for another world, or
            an extra is missing that its trainings or baselines need.
    """
    benchmark, runs = read_benchmark(name, settings), find_runs(folders)
    if runs:
        benchmark = restricted(benchmark, {run.robot for run in runs})
    backend = benchmark.backend
    if backend not in worlds or (len(worlds) > 1 and "analytic" in worlds):
        world = ",".join(worlds)
        raise KinfeasError(f"{name}: its 'backend', {backend}, does not fit --world {world}")
    trainings = [] if runs else plan_runs(benchmark, out)
    if not all(job.path.exists() for job in trainings):
        require("torch", "stable_baselines3")
    planned = plan_evaluations(benchmark, runs)
    check_baselines([case for case in planned if not case.job(out / "results").path.exists()])
    return Study(benchmark, tuple(worlds), out, runs, trainings)
