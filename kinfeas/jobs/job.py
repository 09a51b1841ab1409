"""Jobs: a description in, one JSON file out; and engines, which run them anywhere.

Trainings, parts of a benchmark and trials of a sweep are jobs. A job can be started again at any
time: one with a file is done, a training resumes from its checkpoint, others begin anew.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol

from kinfeas.config import PluginSpec, from_mapping
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.io.files import write_json, writing

ATTEMPTS = 10
"""Times in a row that workers may die before a job is done."""

ENGINES = {name: f"kinfeas.jobs.{name}:{name.title()}" for name in ("local", "ray")}
"""Class of each engine."""

Result = dict[str, Any]
"""The content of a job's file."""


@dataclass(frozen=True)
class Job:
    """A call whose result is kept in a file.

    Attributes:
        call: Function at the top level of a module; its answer is plain data.
        description: Argument of the call, which can be pickled. It determines the result.
        path: JSON file of the result.
    """

    call: Callable[[Any], Mapping[str, Any]]
    description: Any
    path: Path

    def run(self) -> None:
        """Write the result, unless it is there."""
        if not self.path.exists():
            write_json(self.call(self.description), self.path)

    def result(self) -> Result:
        """Return the result; raise KinfeasError if the file is missing or broken."""
        try:
            result = json.loads(self.path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            message = f"{self.path}: broken; remove it to compute it again"
            raise KinfeasError(message) from error
        return dict(result)


class Engine(Protocol):
    """Runs jobs in worker processes, on machines that share the files of this one."""

    def __call__(self, jobs: Sequence[Job]) -> Iterator[Job]:
        """Run jobs, and yield each one that is done; errors of a job are raised.

        A job whose worker was killed may be left out: `run_jobs` runs it again.
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


def build_engine(engine: object, processes: int, address: str | None = None) -> Engine:
    """Return an engine by its name, or by a mapping of its name and parameters.

    Args:
        engine: A name of `ENGINES`, or a mapping such as `{"name": "ray", "address": "auto"}`.
        processes: Number of jobs at a time.
        address: Of a running Ray cluster.
    """
    try:
        spec = PluginSpec.read(engine)
    except ValueError as error:
        raise KinfeasError(f"engine {engine!r}: {error}") from error
    if spec.name not in ENGINES:
        raise KinfeasError(f"unknown engine {spec.name!r}{no_such(spec.name, ENGINES)}")
    factory = resolve_name(ENGINES[spec.name])
    parameters = {"processes": processes, **spec.parameters}
    if address is not None:
        parameters["address"] = address
    built: Engine = from_mapping(factory, parameters, f"engine {spec.name}")
    return built
