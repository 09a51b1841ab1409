"""`kinfeas sweep`: search the keys of a training recipe."""

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import progress, write_drawing, write_json
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from rich.table import Table

    from kinfeas.jobs.job import Result


def sweep(  # noqa: PLR0913, PLR0917 - each option is an argument
    config: Annotated[str, typer.Argument(help="YAML file, or a name such as sweep/pr2.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the sweep.  [default: runs/sweep/NAME]")
    ] = None,
    engine: options.EngineName = "local",
    address: options.EngineAddress = None,
    processes: options.AllProcesses = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Search keys of a training recipe with Optuna. The same command continues after a stop.

    Each trial is a training, pruned by its evaluations. The best trial is written as a recipe for
    train --config. Settings: every key of the configuration, such as trials=40, which extends a
    sweep, or pruner=none.

    Example: kinfeas sweep sweep/pr2

    Example: kinfeas train --config runs/sweep/pr2/best.yaml --seed 1
    """
    require("torch", "stable_baselines3", "matplotlib", "optuna")
    from kinfeas.jobs.job import run_jobs
    from kinfeas.jobs.sweep import BEST, importances, plan_trials, read_sweep, write_best

    chosen = read_sweep(config, options.read_settings(overrides))
    runner = options.read_engine(engine, processes, address)
    folder = out or Path("runs/sweep") / Path(config).stem
    trials = plan_trials(chosen, folder)
    try:
        with _shown(folder, len(trials)) as on_done:
            results = run_jobs(trials, runner, on_done)
    except KeyboardInterrupt:
        sys.stderr.write("interrupted: trials are kept, the same command continues\n")
        raise typer.Exit(130) from None
    from rich.console import Console

    Console().print(_table(results))
    best = write_best(folder, results)
    from kinfeas.viz.plots import search_figure
    from kinfeas.viz.style import png

    figure = search_figure(results, importances(folder))
    write_drawing(lambda: png(figure, 110), folder / "sweep.png")
    write_json(results, folder / "sweep.json")
    write_json(results, json)
    typer.echo(f"best: trial {best['number']}, score {best['score']:.3f}")
    typer.echo(f"train it: kinfeas train --config {shlex.quote(str(folder / BEST))}")


@contextmanager
def _shown(folder: Path, trials: int) -> Iterator[Callable[[], None]]:
    """Show the trials on a terminal, else lines; yield the function to call after each trial."""
    from rich.console import Console
    from rich.live import Live

    from kinfeas.jobs.sweep import open_study, told

    console = Console(stderr=True)
    if not console.is_terminal:
        with progress(f"{trials} trials", trials) as advance:
            yield lambda: advance(1.0)
        return
    study = open_study(folder)
    with Live(
        get_renderable=lambda: _table([told(trial) for trial in study.trials]),
        console=console,
        refresh_per_second=0.5,
        transient=True,
    ):
        yield lambda: None


def _table(results: Sequence["Result"]) -> "Table":
    """Return a table of trials, the best ones first."""
    from rich.table import Table

    table = Table(
        title="score: mean of success and of EE deviation below 5 cm", title_justify="left"
    )
    for name in ("trial", "state", "score", "values"):
        table.add_column(name, justify="right" if name in ("trial", "score") else "left")
    for one in sorted(results, key=lambda one: -one.get("score", -1.0)):
        score = f"{one['score']:.3f}" if "score" in one else "-"
        values = (f"{key.rpartition('.')[2]}={_entry(one['values'][key])}" for key in one["values"])
        table.add_row(str(one["number"]), one["state"], score, " ".join(values))
    return table


def _entry(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
