"""`kinfeas benchmark`: robots x tasks x policies, beside the ceiling and the paper."""

import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_paths, status, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kinfeas.jobs.job import Job, Result


def benchmark(  # noqa: PLR0913, PLR0917 - each option is an argument
    config: str | None = option(None, "YAML file or name.  [default: by --world and --quick]"),
    out: Path | None = option(None, "Folder of the results.  [default: runs/benchmark/NAME]"),
    world: str = option("analytic", "Backend, or several engines with commas."),
    quick: bool = option(False, "Small version of a few minutes.", "--quick"),
    episodes: int | None = option(None, "Episodes of each policy and task."),
    runs: list[Path] | None = option(None, "Training runs, or folders of them; none is trained."),
    policy: Literal["pretrained"] | None = option(None, "Shipped policies; none is trained."),
    engine: options.EngineName = "local",
    address: options.EngineAddress = None,
    processes: options.AllProcesses = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Compare policies in tables and pictures. The same command continues after an interruption.

    Settings: every key of the configuration, such as episodes=100 or seeds=[0,1]. Results are
    identified by robot, task, policy, episodes and settings, not by the code: use another --out
    after an update. With physics they are stored in parts of 20 episodes.

    Example: kinfeas benchmark --quick --out runs/quick

    Example: kinfeas benchmark --world pybullet,mujoco --policy pretrained --episodes 20
    """
    require("matplotlib")
    from kinfeas.benchmark.evaluations import run_benchmark
    from kinfeas.benchmark.markdown import success_tables
    from kinfeas.benchmark.pictures import write_results
    from kinfeas.benchmark.runs import publish
    from kinfeas.benchmark.table import tabulate
    from kinfeas.config.recipes import ENGINES

    worlds = list(map(str.strip, world.split(",")))
    physics = worlds[0] in ENGINES
    shipped = ("physics", "physics_quick") if physics else ("study", "quick")
    name = config or f"benchmark/{shipped[quick]}"
    out = out or Path("runs/benchmark") / Path(name).stem
    if policy and runs:
        raise KinfeasError("--policy and --runs exclude each other")
    backend = worlds[0] if physics and not config else None
    own = {"backend": backend, "policies": policy, "episodes": episodes}

    def run_jobs(jobs: "Sequence[Job]", kind: str) -> "list[Result]":
        return options.run_jobs(jobs, kind, engine, processes, address)

    settings = options.read_settings(overrides, own)
    try:
        study, trained, cases = run_benchmark(name, settings, worlds, runs or [], out, run_jobs)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command continues\n")
        raise typer.Exit(130) from None
    cells = tabulate(cases, *worlds)
    with status("drawing"):
        command = shlex.join(["kinfeas", *sys.argv[1:]])
        paths = write_results(out, study, trained, cases, cells, command)
    write_json([asdict(cell) for cell in cells], json)
    paths += publish(trained if worlds == ["analytic"] else [], out / "pretrained")
    typer.echo("\n".join([*success_tables(cells), study.note]))
    print_paths(*paths)
