"""`kinfeas benchmark`: robots x tasks x policies, beside the ceiling and the paper."""

import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, status, write_json
from kinfeas.cli.train import training_bar
from kinfeas.config.quantities import MOST_EPISODES, MOST_PROCESSES
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.benchmark.findings import Findings
    from kinfeas.benchmark.runs import Plan, Run
    from kinfeas.benchmark.study import BenchmarkConfig
    from kinfeas.benchmark.table import Cell

_RECIPES = {
    ("analytic", False): "benchmark/study",
    ("analytic", True): "benchmark/quick",
    ("pybullet", False): "benchmark/physics",
    ("pybullet", True): "benchmark/physics_quick",
}


def benchmark(  # noqa: PLR0913, PLR0917 - each option is an argument
    config: Annotated[
        str | None,
        typer.Option(
            "--config",
            help="Study by name or YAML file; by default benchmark/study, with --world pybullet "
            "benchmark/physics, with --quick benchmark/quick or benchmark/physics_quick.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder of the results, where a stopped study goes on; by default "
            "runs/benchmark/STUDY.",
        ),
    ] = None,
    world: options.World = "analytic",
    quick: Annotated[
        bool, typer.Option("--quick", help="The small version: a few minutes on two cores.")
    ] = False,
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes",
            min=1,
            max=MOST_EPISODES,
            help="Of each policy on each task; by default the study's.",
        ),
    ] = None,
    runs: Annotated[
        list[Path] | None,
        typer.Option("--runs", help="Take these training runs, or those below, and train none."),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option("--policy", help="pretrained: take the shipped policies and train none."),
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option(
            "--processes",
            min=1,
            max=MOST_PROCESSES,
            help="Processes in all; by default one a core.",
        ),
    ] = None,
    publish: Annotated[
        Path | None,
        typer.Option("--publish", help="Also copy each robot's best policy to DIR/ROBOT."),
    ] = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Set policies side by side: tables, pictures and JSON; what is done is not done again.

    Settings: every key of the study, such as episodes=100 or seeds=[0,1].
    After a change of the program choose another --out: figures are told apart by robot,
    task, policy, episodes and settings, and not by the code.
    With physics they are kept in parts of 20 episodes, which more --episodes take up.
    """
    from kinfeas.benchmark.findings import check_out, write_pictures, write_tables

    name = config or _RECIPES.get((world, quick), world)
    out = out or Path("runs/benchmark") / Path(name).stem
    said = [] if episodes is None else [f"episodes={episodes}"]
    study, taken = _read(name, policy, runs or [], [*said, *(overrides or [])])
    _check_world(study, name, world)
    plans = _plans(study, out, taken)
    if publish is not None and world == "pybullet":
        raise KinfeasError("--publish is for studies of the analytic world")
    if publish is not None and not (taken or plans):
        raise KinfeasError("--publish needs policies that were trained, by the study or by --runs")
    check_out(out)
    cores = processes or os.cpu_count() or 1
    try:
        taken = taken or _train(study, plans, cores)
        findings = _compute(study, taken, out / "cells", cores)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: what is done is kept, the same command goes on from there\n")
        raise typer.Exit(130) from None
    with status("drawing"):
        pictures = write_pictures(findings, out)
    write_tables(findings, [_command()], pictures, out)
    policies = (
        []
        if findings.physics
        else _publish(findings, [out / "pretrained", *([publish] if publish else [])])
    )
    if json is not None:
        _write_json(findings, json)
    _show(findings)
    for path in (out / "table.md", out / "table.json", *pictures, *policies):
        typer.echo(str(path))


def _read(
    name: str,
    policy: str | None,
    folders: Sequence[Path],
    overrides: Sequence[str],
) -> tuple["BenchmarkConfig", list["Run"]]:
    """Return the study that the options ask for, and the runs that it is to take."""
    from kinfeas.benchmark.runs import find_runs
    from kinfeas.benchmark.study import read_benchmark, restricted

    if policy not in (None, "pretrained") or (policy and folders):
        raise KinfeasError("--policy can be pretrained only, and not beside --runs")
    said = ["policies=pretrained"] if policy else []
    study = read_benchmark(name, [*said, *overrides])
    runs = find_runs(folders)
    return (restricted(study, {run.robot for run in runs}) if runs else study), runs


def _check_world(study: "BenchmarkConfig", name: str, world: str) -> None:
    if world == "pybullet" and study.physics is None:
        raise KinfeasError(f"{name}: has no 'physics', which --world pybullet needs")
    if world == "analytic" and study.physics is not None:
        raise KinfeasError(f"{name}: has 'physics', which needs --world pybullet")


def _plans(study: "BenchmarkConfig", out: Path, taken: Sequence["Run"]) -> list["Plan"]:
    """Return the training runs that are to be there, after a check of all policies' names."""
    from kinfeas.benchmark.trainings import to_train
    from kinfeas.policies import pretrained
    from kinfeas.robots.loading import load_robot

    if taken:
        return []
    if study.policies == "pretrained":
        for robot in study.robots:
            pretrained.find(load_robot(robot).name)
    return to_train(study, out)


def _train(study: "BenchmarkConfig", plans: Sequence["Plan"], cores: int) -> list["Run"]:
    """Train what is missing and return all runs."""
    from kinfeas.benchmark.cells import check_baselines
    from kinfeas.benchmark.plan import plan_jobs
    from kinfeas.benchmark.runs import CORES, finish, finish_all, is_missing, read_run

    missing = [plan for plan in plans if is_missing(*plan)]
    if missing:
        check_baselines(plan_jobs(study, []))
    at_once = min(len(missing), cores // CORES)
    if at_once > 1:
        with progress(f"training {len(missing)} runs", len(missing)) as advance:
            finish_all(missing, at_once, lambda: advance(1.0))
    else:
        for number, (settings, folder) in enumerate(missing, start=1):
            sys.stderr.write(f"training {folder} ({number} of {len(missing)})\n")
            with training_bar() as report:
                finish(settings, folder, report)
    return [read_run(folder) for _, folder in plans]


def _compute(
    study: "BenchmarkConfig", runs: Sequence["Run"], folder: Path, processes: int
) -> "Findings":
    from kinfeas.benchmark.cells import run_jobs
    from kinfeas.benchmark.findings import Findings
    from kinfeas.benchmark.plan import PART, plan_jobs

    jobs = plan_jobs(study, runs)
    kind = "cells" if study.physics is None else f"cells and parts of up to {PART} episodes"
    with progress(f"{len(jobs)} {kind}", len(jobs)) as advance:
        results = run_jobs(jobs, folder, processes, lambda _: advance(1.0))
    return Findings(study, runs, jobs, results)


def _publish(findings: "Findings", folders: Sequence[Path]) -> list[Path]:
    """Copy each robot's best policy into each of `folders`; return where they lie now."""
    from kinfeas.benchmark.findings import figures_of_runs
    from kinfeas.benchmark.publish import publish

    figures = figures_of_runs(findings)
    return [
        place for folder in folders for place in publish(findings.runs, figures, folder).values()
    ]


def _write_json(findings: "Findings", path: Path) -> None:
    from kinfeas.benchmark.table import to_json

    write_json(to_json(findings.physics or findings.cells), path)


def _command() -> str:
    return shlex.join(["kinfeas", *sys.argv[1:]])


def _show(findings: "Findings") -> None:
    from kinfeas.benchmark.text import groups, label, title

    cells: Sequence[Cell] = findings.physics or findings.cells
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    rows = []
    for group in groups(cells):
        own = [cell for cell in cells if cell.group == group]
        for row in dict.fromkeys(cell.row for cell in own):
            by_task = {cell.task: cell for cell in own if cell.row == row}
            entries = [_entry(by_task.get(task)) for task in tasks]
            rows.append([title(*group), label(next(iter(by_task.values()))), *entries])
        ceilings = {cell.task: f"{100 * cell.ceiling:.1f}" for cell in own}
        rows.append([title(*group), "ceiling", *(ceilings.get(task, "-") for task in tasks)])
    heads = ["robot", "policy", *(f" {task}" for task in tasks)]
    print_table("% of episodes without a kinematic failure", heads, rows)
    if findings.study.note:
        typer.echo(findings.study.note)


def _entry(cell: "Cell | None") -> str:
    if cell is None:
        return "-"
    spread = "" if cell.success_std is None else f" ± {100 * cell.success_std:.1f}"
    return f"{100 * cell.success:.1f}{spread}"
