"""`kinfeas sweep`: search the keys of a training recipe."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_table, write_drawing, write_json
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kinfeas.jobs.job import Result


def sweep(  # noqa: PLR0913, PLR0917 - each option is an argument
    config: str = argument(..., "YAML file, or a name such as sweep/pr2."),
    out: Path | None = option(None, "Folder of the sweep.  [default: runs/sweep/NAME]"),
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

    Example: kinfeas train --config runs/sweep/pr2/best.yaml --minutes 3
    """
    require("torch", "stable_baselines3", "matplotlib", "optuna")
    from kinfeas.jobs.sweep import BEST, importances, plan_trials, read_sweep, write_best

    settings = read_sweep(config, options.read_settings(overrides))
    folder = out or Path("runs/sweep") / Path(config).stem
    trials = plan_trials(settings, folder)
    results = options.run_jobs(trials, "trials", engine, processes, address)
    columns = [" trial", "state", " score", "values"]
    print_table("score: mean of success and of tracking errors below 5 cm", columns, _rows(results))
    best = write_best(folder, results)
    from kinfeas.viz.plots import search_figure
    from kinfeas.viz.style import png

    figure = search_figure(results, importances(folder))
    write_drawing(lambda: png(figure, 110), folder / "sweep.png")
    write_json(results, folder / "sweep.json")
    write_json(results, json)
    typer.echo(f"best: trial {best['number']}, score {best['score']:.3f}")
    typer.echo(f"train it: kinfeas train --config {shlex.quote(str(folder / BEST))}")


def _rows(results: "Sequence[Result]") -> list[list[str]]:
    """Return the rows of a table of trials, the best ones first."""
    rows = []
    for trial in sorted(results, key=lambda trial: -trial.get("score", -1.0)):
        score = f"{trial['score']:.3f}" if "score" in trial else "-"
        values = ", ".join(f"{key}={value}" for key, value in trial["values"].items())
        rows.append([str(trial["number"]), trial["state"], score, values])
    return rows
