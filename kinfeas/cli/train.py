"""`kinfeas train`, `sweep` and `export`: trainings, and their policies as ONNX files."""

import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from kinfeas.cli import options
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import (
    percent,
    print_facts,
    print_table,
    progress,
    status,
    write_drawing,
    write_json,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.api.train import OnTraining, Run
    from kinfeas.jobs.job import Result
    from kinfeas.training.config import TrainConfig
    from kinfeas.training.run import Progress


_OF_TRAINING = "adapters", "filters", "ik", "max_failures", "reward"
"""Settings of worlds that differ between training and evaluation."""


def train(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: str | None = option(
        None, f"{options.ROBOT}  [default: robot of --config or --init, else pr2]"
    ),
    task: str | None = option(None, f"{options.TASK}  [default: ggr]"),
    seed: int | None = option(None, "Random seed.  [default: 0]"),
    minutes: float | None = option(None, "Time; with physics including evaluations.  [default: 3]"),
    steps: int | None = option(None, "Environment steps, in place of or beside --minutes."),
    adapters: options.AdapterList = None,
    world: options.World = "analytic",
    init: str | None = option(None, "Policy to start from: a run folder, or pretrained."),
    processes: int | None = option(None, "Processes of a physics world.  [default: 2]"),
    out: Path | None = option(None, "Folder of the run.  [default: runs/ROBOT-TASK-SEED]"),
    config: str | None = option(
        None,
        "Recipe: a YAML file, or a name such as train_rooms or paper/pr2.  "
        "[default: that of the robot]",
    ),
    overrides: options.Overrides = None,
    resume: Path | None = option(
        None, "Run folder to resume; --minutes and --steps extend it, --robot and --task may move."
    ),
) -> None:
    """Train a base policy. Ctrl-C and SIGTERM leave a checkpoint to --resume from.

    Recipes are sections of the robot: train, with --world pybullet or mujoco train_physics,
    with --init as well finetune_physics. Settings: every key of the recipe, such as
    learner.batch_size=256. train_physics begins in the analytic world.

    With --steps, a resumed run equals one that was never interrupted. Only in PyBullet, with
    several processes, and with path_planner, episodes in progress restart.

    Example: kinfeas train --robot pr2 --minutes 3 --out runs/pr2

    Example: kinfeas train --resume runs/pr2
    """
    require("torch", "stable_baselines3")
    from kinfeas.api import train as training

    if resume is None:
        settings = training.configure(
            robot, task=task, seed=seed, minutes=minutes, steps=steps,
            adapters=adapters, world=world, init=init, processes=processes, config=config,
            settings=options.read_settings(overrides),
        )  # fmt: skip
        run = train_run(settings, out or training.default_folder(settings))
    else:
        excluded = (seed, adapters, init, processes, out, config, overrides)
        if world != "analytic" or any(value is not None for value in excluded):
            raise KinfeasError("--resume excludes all but --minutes, --steps, --robot, --task")
        with training_progress(resume) as report:
            run = training.resume(
                resume, minutes=minutes, steps=steps, robot=robot, task=task, on_progress=report
            )
    _show(run, adapters)


def train_run(config: "TrainConfig", folder: Path) -> "Run":
    """Train with a progress bar and return the run."""
    from kinfeas.api.train import begin

    with training_progress(folder) as report:
        return begin(config, folder, report)


@contextmanager
def training_progress(folder: Path) -> Iterator["OnTraining"]:
    """Show progress; on Ctrl-C or SIGTERM print how to resume, and exit with 128 + signal."""
    from kinfeas.training.run import SETTINGS

    ended: list[int] = []

    def end(number: int, _: object) -> None:
        ended.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        with progress() as on_progress:
            yield lambda now: on_progress(describe(now), now.fraction)
    except KeyboardInterrupt:
        resume = shlex.join(["kinfeas", "train", "--resume", str(folder)])
        begun = (folder / SETTINGS).is_file()
        sys.stderr.write(f"interrupted; {f'resume with: {resume}' if begun else 'not begun'}\n")
        raise typer.Exit(128 + (ended or [signal.SIGINT])[0]) from None
    finally:
        signal.signal(signal.SIGTERM, before)


def describe(now: "Progress") -> str:
    """Return steps, speed, success, best evaluation and remaining time of a run in one line."""
    if now.evaluating is not None:
        done, episodes = now.evaluating
        return f"{now.steps:,} steps, evaluating {done}/{episodes} episodes"
    # NaN and -1 mean unknown.
    recent = f"{now.success:.0%}" if now.success >= 0.0 else "-"
    best = f", best evaluation {now.best:.1%} (mean of success and tracking within 5 cm)"
    return (
        f"{now.steps:,} steps, {now.steps / max(now.seconds, 1e-9):,.0f}/s, "
        f"success while learning {recent}{best if now.best >= 0.0 else ''}, "
        f"{now.left_seconds / 60.0:.1f} min left"
    )


def _show(run: "Run", adapters: str | None) -> None:
    from kinfeas.config import to_mapping, to_options
    from kinfeas.evaluation import evaluate
    from kinfeas.training.run import read_settings

    best, config = run.metrics, read_settings(run.folder)
    defaults = to_mapping(evaluate.read_settings(config.robot, config.world.backend).world)
    settings = {f"task.{key}": value for key, value in config.task_parameters.items()}
    settings |= {
        f"world.{key}": value
        for key, value in to_mapping(config.world).items()
        if key not in _OF_TRAINING and value != defaults[key]
    }
    used = [*best["adapters"], *best["filters"]]
    using = f"with {', '.join(used)}" if used else "without filters"
    success = percent(best["success"], best["success_low"], best["success_high"])
    rows = [
        ["steps", f"{run.steps:,}"],
        ["time of training", f"{run.seconds / 60.0:.1f} min"],
        [f"success of the best checkpoint, {best['episodes']} fresh episodes, {using}", success],
        ["steps of the best checkpoint", f"{best['steps']:,}"],
    ]
    print_table(f"trained: {run.folder}", ["", "value (95 % interval)"], rows)
    command = ["kinfeas", "evaluate", "--robot", best["trained_with"], "--task", best["task"]]
    command += ["--world", best["world"], "--policy", str(run.folder)]
    command += [] if adapters is None else ["--adapters", adapters]
    command += to_options(settings)
    typer.echo(f"evaluate it with the robot's filters: {shlex.join(command)}")


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
    from kinfeas.viz.plots import search_figure
    from kinfeas.viz.style import png

    settings = read_sweep(config, options.read_settings(overrides))
    folder = out or Path("runs/sweep") / Path(config).stem
    trials = plan_trials(settings, folder)
    results = options.run_jobs(trials, "trials", engine, processes, address)
    columns = [" trial", "state", " score", "values"]
    print_table(
        "score: mean of success and of tracking errors below 5 cm", columns, _trials(results)
    )
    best = write_best(folder, results)
    figure = search_figure(results, importances(folder))
    write_drawing(lambda: png(figure, 110), folder / "sweep.png")
    write_json(results, folder / "sweep.json")
    write_json(results, json)
    typer.echo(f"best: trial {best['number']}, score {best['score']:.3f}")
    typer.echo(f"train it: kinfeas train --config {shlex.quote(str(folder / BEST))}")


def _trials(results: "Sequence[Result]") -> list[list[str]]:
    """Return the rows of a table of trials, the best ones first."""
    rows = []
    for trial in sorted(results, key=lambda trial: -trial.get("score", -1.0)):
        score = f"{trial['score']:.3f}" if "score" in trial else "-"
        values = ", ".join(f"{key}={value}" for key, value in trial["values"].items())
        rows.append([str(trial["number"]), trial["state"], score, values])
    return rows


def export(
    policy: str | None = argument(None, "Folder of a run or checkpoint, or pretrained."),
    out: Path | None = options.file_option(None, "File to write.", ".onnx"),
    check: Path | None = option(None, "Verify this file, write nothing.", metavar="FILE.onnx"),
    robot: options.PolicyRobotName = None,
    json: options.JsonPath = None,
) -> None:
    """Write or verify a policy as ONNX file. The file describes itself.

    The file answers as the training policy does, to 1e-5. It runs with onnxruntime alone, and
    --policy of other commands takes it.

    Example: kinfeas export runs/pr2 --out pr2.onnx

    Example: kinfeas export --check pr2.onnx --robot pr2
    """
    from kinfeas.api import load as api

    if check is not None and policy is None and out is None:
        file = api.check_export(check, robot=robot)
        compared = f"fits {file.robot}" if file.robot else "not compared with a robot: no --robot"
        title = f"valid policy file: {check}, {compared}"
    elif policy is not None and out is not None and check is None:
        with status("exporting"):
            file = api.export(policy, out, robot=robot)
        title = f"exported: {out}"
    else:
        raise KinfeasError("give POLICY and --out FILE to export, or --check FILE to verify")
    facts: dict[str, Any] = file.facts()
    write_json(facts, json)
    for terms in ("observation", "action"):
        facts[terms] = [{k: v for k, v in term.items() if v != []} for term in facts[terms]]
    print_facts(title, {k: v for k, v in facts.items() if k not in ("training", "golden")})
