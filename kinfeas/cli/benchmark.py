"""`kinfeas benchmark`: robots x tasks x policies, beside the ceiling and the paper."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import progress, status, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.benchmark.config import BenchmarkConfig
    from kinfeas.benchmark.evaluations import Evaluation
    from kinfeas.benchmark.runs import Run
    from kinfeas.jobs.job import Engine, Job, Result


def benchmark(  # noqa: PLR0913, PLR0917 - each option is an argument
    config: Annotated[
        str | None,
        option("YAML file, or a name such as benchmark/study.  [default: by --world and --quick]"),
    ] = None,
    out: Annotated[
        Path | None, option("Folder of the results.  [default: runs/benchmark/NAME]")
    ] = None,
    world: Annotated[
        str,
        option("Backend: analytic, pybullet, mujoco, or a plugin; several engines with commas."),
    ] = "analytic",
    quick: Annotated[bool, option("Small version of a few minutes.", "--quick")] = False,
    episodes: Annotated[
        int | None, options.episodes_option("Number of episodes for each policy and task.")
    ] = None,
    runs: Annotated[
        list[Path] | None, option("Existing training runs, or folders of them; none is trained.")
    ] = None,
    policy: Annotated[
        Literal["pretrained"] | None, option("Shipped policies; none is trained.")
    ] = None,
    engine: options.EngineName = "local",
    address: options.EngineAddress = None,
    processes: options.AllProcesses = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Compare policies in tables and pictures. Existing results are kept.

    Settings: every key of the configuration, such as episodes=100 or seeds=[0,1]. Results are
    identified by robot, task, policy, episodes and settings, not by the code: use another --out
    after an update. With physics they are stored in parts of 20 episodes.

    Example: kinfeas benchmark --quick --out runs/quick

    Example: kinfeas benchmark --world pybullet,mujoco --policy pretrained --episodes 20
    """
    from kinfeas.benchmark.config import read_benchmark, restricted
    from kinfeas.benchmark.evaluations import plan_evaluations
    from kinfeas.benchmark.runs import find_runs, read_run
    from kinfeas.io.files import write_file, writing

    require("matplotlib")
    worlds = world.split(",")
    name, backend = (config, None) if config else _recipe(worlds[0], quick)
    out = out or Path("runs/benchmark") / Path(name).stem
    if policy and runs:
        raise KinfeasError("--policy and --runs exclude each other")
    own = {"backend": backend, "policies": policy, "episodes": episodes}
    settings = options.read_settings(overrides, own)
    study, trained_runs = read_benchmark(name, settings), find_runs(runs or [])
    if trained_runs:
        study = restricted(study, {run.robot for run in trained_runs})
    if study.backend not in worlds or (len(worlds) > 1 and "analytic" in worlds):
        raise KinfeasError(f"{name}: its 'backend', {study.backend}, does not fit --world {world}")
    plans = [] if trained_runs else _plans(study, out)
    runner = options.read_engine(engine, processes, address)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    try:
        if plans:
            _run("trainings", plans, runner)
            trained_runs = [read_run(job.path.parent) for job in plans]
        evaluations = [
            case
            for each in worlds
            for case in plan_evaluations(replace(study, backend=each), trained_runs)
        ]
        # Engines have the same references.
        evaluations = list(
            {(case.name, case.row, case.variant): case for case in evaluations}.values()
        )
        results = _evaluate([case.job(out / "results") for case in evaluations], runner)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: results are kept, the same command continues\n")
        raise typer.Exit(130) from None
    from kinfeas.benchmark.markdown import success_tables, to_markdown
    from kinfeas.benchmark.pictures import draw_pictures
    from kinfeas.benchmark.table import tabulate

    cases = list(zip(evaluations, results, strict=True))
    cells = tabulate(cases, *worlds)
    with status("drawing"):
        pictures = draw_pictures(study, trained_runs, cases, cells)
    files = {f"{key}.png": picture for key, picture in pictures.items()}
    files["table.md"] = to_markdown(cells, study.note, [_command()], list(files)).encode()
    for key, content in files.items():
        write_file(out / key, content)
    entries = [asdict(cell) for cell in cells]
    write_json(entries, out / "table.json")
    write_json(entries, json)
    trained = world == "analytic" and (plans or runs)
    published = _publish(trained_runs, cases, out / "pretrained") if trained else []
    typer.echo("\n".join([*success_tables(cells), study.note]))
    for path in (*(out / key for key in files), out / "table.json", *published):
        typer.echo(str(path))


def _recipe(world: str, quick: bool) -> tuple[str, str | None]:
    """Return the recipe of a world, and its engine."""
    from kinfeas.config.recipes import ENGINES

    if world in ENGINES:
        return "benchmark/physics_quick" if quick else "benchmark/physics", world
    known = {"analytic": "benchmark/quick" if quick else "benchmark/study"}
    return known.get(world, world), None


def _plans(benchmark: "BenchmarkConfig", out: Path) -> list["Job"]:
    """Return the training runs of a benchmark, after a check that policies can be built."""
    from kinfeas.benchmark.evaluations import check_baselines, plan_evaluations
    from kinfeas.benchmark.runs import plan_runs
    from kinfeas.policies.loading import PRETRAINED, trained_folder
    from kinfeas.robots.loading import load_robot

    if benchmark.policies == PRETRAINED:
        for robot in benchmark.robots:
            trained_folder(PRETRAINED, load_robot(robot))
    plans = plan_runs(benchmark, out)
    if not all(job.path.exists() for job in plans):
        require("torch", "stable_baselines3")
        check_baselines(plan_evaluations(benchmark, []))
    return plans


def _evaluate(jobs: Sequence["Job"], engine: "Engine") -> list["Result"]:
    """Evaluate what is missing, after a check that its baselines can be built."""
    from kinfeas.benchmark.evaluations import check_baselines

    check_baselines([job.description for job in jobs if not job.path.exists()])
    return _run("evaluations", jobs, engine)


def _run(kind: str, jobs: Sequence["Job"], engine: "Engine") -> list["Result"]:
    """Run jobs with a progress bar."""
    from kinfeas.jobs.job import run_jobs

    paths = {job.path for job in jobs}
    missing = sum(not path.exists() for path in paths)
    kept = f" ({len(paths) - missing} kept)" if missing < len(paths) else ""
    with progress(f"{missing} {kind} to do{kept}", missing) as advance:
        return run_jobs(jobs, engine, lambda: advance(1.0))


def _publish(
    runs: Sequence["Run"], cases: Sequence[tuple["Evaluation", "Result"]], folder: Path
) -> list[Path]:
    """Copy each robot's best policy into a folder of its own in `folder`; return these folders."""
    from kinfeas.benchmark.runs import publish

    metrics: dict[Path, dict[str, object]] = {}
    for job, result in cases:
        if job.training_seed is not None and not (job.variant or job.row):
            kept = {key: value for key, value in result.items() if key != "workspace"}
            metrics.setdefault(Path(job.source), {})[job.task_name] = kept
    return publish(runs, metrics, folder)


def _command() -> str:
    return shlex.join(["kinfeas", *sys.argv[1:]])
