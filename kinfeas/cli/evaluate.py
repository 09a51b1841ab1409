"""`kinfeas evaluate`, `ceiling` and `benchmark`: metrics of policies, and their upper bound."""

import shlex
import sys
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import percent, print_paths, print_table, progress, status, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.evaluation.evaluate import Summary


_LISTED = 6  # numbers of failed episodes that the table shows
_REASONS = {
    "ik_failure": "IK failure", "collision": "collision", "time": "out of time",
    "task": "task not done",
}  # fmt: skip


def evaluate(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyName,
    robot: options.PolicyRobotName = None,
    task: options.TaskName = "ggr",
    world: options.World = "analytic",
    episodes: int | None = option(None, "Episodes.  [default: 500, with physics 50]"),
    seed: options.Seed = 1,
    head_start: float | None = option(None, "Seconds of base motion before the EE.  [default: 0]"),
    time_scale: float | None = option(None, "Relative EE speed.  [default: of the robot]"),
    without_objects: bool = option(False, "Physics: leave out the furniture.", "--no-objects"),
    filters: options.Filters = None,
    gui: bool = option(False, "PyBullet: show a window.", "--gui"),
    adapters: options.AdapterList = None,
    ablation: bool = option(
        False, "Also evaluate no adapter, each alone, and all but one.", "--ablation"
    ),
    picture: Path | None = options.file_option(None, "Draw an episode.", ".png"),
    video: options.Video = None,
    replay: Path | None = options.file_option(
        None, "Interactive page of an episode.", ".html", ".htm"
    ),
    episode: int = option(0, "Number of the episode to show.", min=0),
    processes: options.Processes = 1,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Evaluate a policy.

    The ceiling is the fraction of goals that some base pose reaches. Pictures: desired EE path
    dashed, achieved green.

    Settings: task.KEY and world.KEY: dt, max_failures, max_seconds, arm_settle_timeout, ik.KEY,
    filters, adapters, backend_parameters.KEY.

    Example: kinfeas evaluate --policy pretrained --task door --world pybullet
    """
    from kinfeas.api import evaluate as api

    if world == "analytic" and (without_objects or gui):
        name = "--gui" if gui else "--no-objects"
        raise KinfeasError(f"{name} is for worlds with physics: --world pybullet")
    own = {
        "world.head_start": head_start,
        "world.time_scale": time_scale,
        "world.backend_parameters.objects": False if without_objects else None,
        "world.backend_parameters.gui": gui or None,
    }
    with progress() as on_progress:
        summary = api.evaluate(
            policy, robot=robot, task=task, world=world, episodes=episodes, seed=seed,
            filters=filters, adapters=adapters, ablation=ablation, picture=picture, video=video,
            replay=replay, episode=episode, processes=1 if gui else processes,
            settings=options.read_settings(overrides, own), on_progress=on_progress,
        )  # fmt: skip
    _show(summary)
    if ablation:
        rows = [
            [
                label,
                _fraction(row, "success"),
                percent(row["reached"]),
                f"{1000.0 * row['mean_deviation_m']:.1f} mm",
            ]
            for label, row in {**summary["ablation"], "all": summary}.items()
        ]
        print_table("adapters", ["", " success", " reached", " deviation"], rows)
    write_json(summary, json)
    print_paths(video, replay, picture, json)


def ceiling(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = DEFAULT_ROBOT,
    task: options.TaskName = "ggr",
    episodes: options.Episodes = 500,
    seed: options.Seed = 1,
    path: bool = option(False, "Also check 16 poses on the way to each sub-goal.", "--path"),
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Compute the fraction of reachable goals. It is an upper bound for every policy.

    Goals are exact, but for robots with a pose tolerance, while success allows 2.5 cm and 12
    degrees: policies may exceed the bound a little.

    The goals are those of kinfeas evaluate with the same seed. All sub-goals of an episode count as
    one; those out of reach are listed with the reason. Settings: ik.KEY, such as
    ik.self_collision=false, and task.KEY, the task's parameters.

    Example: kinfeas ceiling --robot pr2 --task door --path --episodes 100
    """
    from kinfeas.api import evaluate as api
    from kinfeas.planning.reach import LIMITS

    settings = options.read_settings(overrides)
    with progress() as on_progress:
        bound = api.ceiling(
            robot, task=task, episodes=episodes, seed=seed, path=path, settings=settings,
            on_progress=on_progress,
        )  # fmt: skip
    write_json(asdict(bound), json)
    what = f"{bound.task}{', path included' if path else ''}"
    title = f"ceiling of {what}, robot {bound.robot}, {episodes} goals of seed {seed}"
    stages = zip(bound.base_poses, bound.convergence, strict=True)
    rows = [[f"reached with {count} base poses a goal", percent(value)] for count, value in stages]
    rows.append(["reachable", percent(bound.ceiling, bound.ceiling_low, bound.ceiling_high)])
    for number, limits in enumerate(bound.out_of_reach, 1):
        for limit, count in sorted(limits.items()):
            what = f"sub-goal {number} out of reach, {limit}: {LIMITS[limit]}"
            rows.append([what, percent(count / episodes)])
    print_table(title, ["", " fraction (95 % interval)"], rows)


def _show(summary: "Summary") -> None:
    rms = summary["rms_deviation_m"]
    end = "goal" if rms is None else "end"
    title = "{policy} on {task}, robot {robot}, {episodes} episodes of seed {seed}, {world}"
    rows = [
        [f"success: {end} reached, no IK failure", _fraction(summary, "success")],
        ["EE always within 5 cm of path and goal", _fraction(summary, "within_5cm")],
        [f"{end} reached", percent(summary["reached"])],
        ["IK failures an episode", f"{summary['ik_failures_per_episode']:.2f}"],
        ["EE deviation, mean", f"{1000 * summary['mean_deviation_m']:.1f} mm"],
        ["joint jumps an episode", f"{summary['joint_jumps_per_episode']:.2f}"],
        ["steps an episode", f"{summary['mean_steps']:.0f}"],
    ]
    if summary["adapters"]:  # else the same as without localisation
        rows[2:2] = [["the same, seen by its localisation", _fraction(summary, "tracked_5cm")]]
        tracking = f"{1000 * summary['mean_tracking_error_m']:.1f} mm"
        rows.append(["tracking error, mean", tracking])
    if summary["ceiling"] is not None:
        rows.insert(1, ["ceiling: goals within reach of a base", _fraction(summary, "ceiling")])
    if (lateness := summary["lateness_s"]) is not None:
        rows.append(["base later than its response model", f"{round(1000 * lateness)} ms"])
    if rms is not None:
        rows += [
            ["followed without failure and joint jump", _fraction(summary, "smooth")],
            ["EE speed relative to the target", percent(summary["speed_share"])],
            ["EE deviation, root mean square", f"{1000 * rms:.1f} mm"],
        ]
    if summary["collision_free_rate"] is not None:
        if summary["task_success"] is not None:
            rows.append(["task success", _fraction(summary, "task_success")])
        rows += [
            ["episodes without a collision", percent(summary["collision_free_rate"])],
            ["collisions of the base an episode", f"{summary['base_collisions']:.2f}"],
            ["collisions of the arm an episode", f"{summary['arm_collisions']:.2f}"],
        ]
    for reason, failed in summary["failed"].items():
        numbers = ", ".join(map(str, failed[:_LISTED])) + ", ..." * (len(failed) > _LISTED)
        rows.append([f"failed: {_REASONS[reason]}", numbers])
    print_table(title.format(**summary), ["", " fraction (95 % interval) or mean"], rows)
    used = ", ".join(summary["filters"])
    typer.echo(f"filters: {used} (--filters none is the policy alone)" if used else "no filters")


def _fraction(summary: Mapping[str, Any], key: str) -> str:
    return percent(*(summary[f"{key}{end}"] for end in ("", "_low", "_high")))


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
    from kinfeas.benchmark.evaluations import publish, run_benchmark
    from kinfeas.benchmark.markdown import success_tables
    from kinfeas.benchmark.pictures import write_results
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
    settings = options.read_settings(overrides, own)
    run_jobs = partial(options.run_jobs, engine=engine, processes=processes, address=address)
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
