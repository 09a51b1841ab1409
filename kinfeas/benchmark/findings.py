"""A benchmark: all that is written of what its jobs found."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.benchmark.cells import Result
from kinfeas.benchmark.curves import curves_figure
from kinfeas.benchmark.job import Job
from kinfeas.benchmark.physics import PhysicsCell, tabulate_physics
from kinfeas.benchmark.physics_text import physics_markdown
from kinfeas.benchmark.plot import table_figure
from kinfeas.benchmark.runs import Run
from kinfeas.benchmark.study import BenchmarkConfig
from kinfeas.benchmark.table import Cell, tabulate, to_json
from kinfeas.benchmark.text import to_markdown
from kinfeas.benchmark.workspace import Covered, covered, workspace_figure
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.world import World, WorldConfig
from kinfeas.evaluation.paper import LEARNED, paper_figures
from kinfeas.evaluation.recording import Recording, record_episodes
from kinfeas.io.files import write_file, writing
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task
from kinfeas.viz.episodes import episodes_figure
from kinfeas.viz.style import failures_text, png


@dataclass(frozen=True)
class Findings:
    """All that a benchmark has found.

    Attributes:
        study: What was asked.
        runs: The training runs that it stands on.
        jobs: What was computed.
        results: What each of the jobs came to.
    """

    study: BenchmarkConfig
    runs: Sequence[Run]
    jobs: Sequence[Job]
    results: Sequence[Result]

    @cached_property
    def cells(self) -> list[Cell]:
        """The table of the analytic world."""
        return tabulate(*self._found(physical=False))

    @cached_property
    def physics(self) -> list[PhysicsCell]:
        """The table of the PyBullet world; empty if it was not asked for."""
        return tabulate_physics(*self._found(physical=True), self.cells)

    def _found(self, *, physical: bool) -> tuple[list[Job], list[Result]]:
        both = zip(self.jobs, self.results, strict=True)
        own = [(job, result) for job, result in both if job.physical == physical]
        return [job for job, _ in own], [result for _, result in own]


def write_tables(
    findings: Findings, commands: Sequence[str], pictures: Sequence[Path], out: Path
) -> None:
    """Write `table.json` and `table.md` into the folder `out`.

    Args:
        findings: What to write.
        commands: Lines that make all of it again.
        pictures: Files in `out` that `table.md` shows.
        out: An existing folder.
    """
    physics, note = findings.physics, findings.study.note
    cells: Sequence[Cell] = physics or findings.cells
    data = json.dumps(to_json(cells), indent=2, allow_nan=False) + "\n"
    shown = [path.relative_to(out).as_posix() for path in pictures]
    if physics:
        text = physics_markdown(physics, note, commands, shown)
    else:
        text = to_markdown(cells, note, commands, shown)
    write_file(out / "table.json", data.encode())
    write_file(out / "table.md", text.encode())


def write_pictures(findings: Findings, out: Path) -> list[Path]:
    """Draw what there is to draw into the folder `out` and return the files.

    `table.png`; in the analytic world also `learning_curves.png` where there were runs;
    `workspace.png` and for each robot `examples-ROBOT.png` where there are learned policies.
    """
    if findings.physics:
        pictures = {"table": png(table_figure(findings.physics, findings.study.note), 110)}
        return _keep(pictures, out)
    pictures = {"table": png(table_figure(findings.cells, findings.study.note), 110)}
    if findings.runs:
        pictures["learning_curves"] = png(curves_figure(_ordered(findings), _levels(findings)), 110)
    if spaces := _spaces(findings):
        pictures["workspace"] = png(workspace_figure(spaces), 90)
    for robot in findings.study.robots:
        if shown := _examples(findings, robot):
            known = load_robot(robot)
            titles = [_title(task, recording) for task, recording in shown.items()]
            figure = episodes_figure(known, list(shown.values()), titles)
            pictures[f"examples-{known.name}"] = png(figure, 80)
    return _keep(pictures, out)


def _keep(pictures: dict[str, bytes], out: Path) -> list[Path]:
    for name, picture in pictures.items():
        write_file(out / f"{name}.png", picture)
    return [out / f"{name}.png" for name in pictures]


def figures_of_runs(findings: Findings) -> dict[Path, dict[str, Any]]:
    """Return for each run's folder its figures by task, variants left out."""
    found: dict[Path, dict[str, Any]] = {}
    for job, result in zip(findings.jobs, findings.results, strict=True):
        own = not (job.variant or job.physical or job.aided)
        if job.training_seed is not None and own:
            told = {"seed": job.seed, **result["figures"]}
            found.setdefault(Path(job.source), {})[job.task_name] = told
    return found


def _ordered(findings: Findings) -> list[Run]:
    """Return the runs in the order of the study's robots."""
    names = [load_robot(robot).name for robot in findings.study.robots]
    return sorted(findings.runs, key=lambda run: names.index(run.robot))


def _levels(findings: Findings) -> dict[str, dict[str, float]]:
    """Return for each robot what its learning curves are to be compared with."""
    levels: dict[str, dict[str, float]] = {}
    trained = {run.robot: run.task for run in findings.runs}
    for cell in findings.cells:
        if trained.get(cell.robot) == cell.task and not cell.variant:
            levels[cell.robot] = {"ceiling": cell.ceiling}
            if paper := paper_figures(cell.robot, cell.task).get(LEARNED):
                levels[cell.robot]["paper"] = paper.success
    return levels


def _spaces(findings: Findings) -> list[Covered]:
    """Return for each robot what the policies of its first learned kind cover on all tasks."""
    found = []
    for robot in findings.study.robots:
        own = [
            (job.policy, result)
            for job, result in zip(findings.jobs, findings.results, strict=True)
            if job.robot == robot and "workspace" in result and not job.variant
        ]
        if own:
            of_kind = [result for policy, result in own if policy == own[0][0]]
            found.append(covered(load_robot(robot), of_kind))
    return found


def _examples(findings: Findings, robot: str) -> dict[str, Recording]:
    """Return for each task an episode of a robot's first learned policy.

    It is episode 0 of the first task, 1 of the second and so on: equal numbers are alike.
    """
    shown: dict[str, Recording] = {}
    known = load_robot(robot)
    for job, result in zip(findings.jobs, findings.results, strict=True):
        if job.robot != robot or "workspace" not in result or job.variant:
            continue
        if job.task_name in shown:
            continue
        assert isinstance(job.world, WorldConfig)  # who samples the workspace
        world = World(known, load_task(job.task, job.parameters), job.world, job.seed)
        (shown[job.task_name],) = record_episodes(
            world, load_policy(job.source, known), 1, first=len(shown)
        )
    return shown


def _title(task: str, recording: Recording) -> str:
    """Return what stands above an episode of a task: the task, and what the episode came to."""
    end = "goal reached" if recording.reached else "goal missed"
    failures = failures_text(int(np.sum(~recording.feasible)))
    return f"{task}: {end}, {failures}, {(len(recording.feasible) - 1) * recording.dt:.0f} s"


def check_out(out: Path) -> None:
    """Make the folder `out` and check that a file can be written there.

    Raises:
        KinfeasError: If it cannot.
    """
    if out.exists() and not out.is_dir():
        raise KinfeasError(f"{out}: is a file, --out needs a folder")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
