"""`kinfeas evaluate`: metrics of a policy, and films of its episodes."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinfeas.cli import options
from kinfeas.cli.output import (
    print_table,
    progress,
    share,
    status,
    write_drawing,
    write_json,
    write_video,
)
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.core.policy import Policy
    from kinfeas.evaluation.evaluate import EvalConfig, Summary


def evaluate(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyName,
    robot: options.PolicyRobotName = None,
    task: options.TaskName = "ggr",
    world: options.World = "analytic",
    episodes: Annotated[
        int | None,
        options.episodes_option("Number of episodes.  [default: 500, with physics 50]"),
    ] = None,
    seed: options.Seed = 1,
    head_start: Annotated[
        float | None, typer.Option(help="Seconds of base motion before the EE.  [default: 0]")
    ] = None,
    time_scale: Annotated[
        float | None,
        typer.Option(help="Relative EE speed.  [default: of the robot]"),
    ] = None,
    without_objects: Annotated[
        bool, typer.Option("--no-objects", help="Physics: leave out the furniture.")
    ] = False,
    filters: options.Filters = None,
    gui: Annotated[bool, typer.Option("--gui", help="PyBullet: show a window.")] = False,
    adapters: options.AdapterList = None,
    ablation: Annotated[
        bool,
        typer.Option("--ablation", help="Also evaluate single adapters."),
    ] = False,
    picture: Annotated[Path | None, options.file_option("Draw an episode.", ".png")] = None,
    video: options.Video = None,
    replay: Annotated[
        Path | None,
        options.file_option("Write an episode as an interactive page.", ".html", ".htm"),
    ] = None,
    episode: Annotated[int, typer.Option(min=0, help="Number of the episode to show.")] = 0,
    processes: options.Processes = 1,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Evaluate a policy.

    The ceiling is the share of goals that some base pose reaches. Pictures: desired EE path dashed,
    achieved green.

    Settings: task.KEY and world.KEY: dt, max_failures, max_seconds, arm_settle_timeout, ik.KEY,
    filters, adapters, backend_parameters.KEY.

    Example: kinfeas evaluate --policy pretrained --task door --world pybullet
    """
    from kinfeas.evaluation.evaluate import (
        adapter_subsets,
        default_episodes,
        prepare,
        reachability_of,
    )
    from kinfeas.evaluation.evaluate import evaluate as run

    robot = robot or options.robot_of(policy)
    count = episodes or default_episodes(world)
    if episode >= count:
        raise KinfeasError(f"--episode must be below --episodes, {count}, not {episode}")
    given: dict[str, object] = {"world.head_start": head_start, "world.time_scale": time_scale}
    given |= {"world.backend_parameters.objects": False if without_objects else None}
    given |= {"world.backend_parameters.gui": gui or None}
    given |= options.adapters_of_world(adapters)
    assigned = options.assignments(options.given(given))
    settings = [*assigned, *options.with_filters(filters, overrides or [])]
    chosen, driver = prepare(
        policy, robot, task, world, episodes=count, seed=seed, overrides=settings
    )
    with progress("ceiling") as advance:
        ceiling = reachability_of(chosen, advance)
    cores = 1 if gui else processes
    with progress(f"{count} episodes", count) as advance:
        summary = run(chosen, driver, policy, ceiling, cores, advance)
    rows = {}
    if ablation:
        parts = adapter_subsets(chosen.world.adapters)
        with progress(f"{len(parts)} evaluations", len(parts)) as advance:
            for label, some in parts.items():
                part = replace(chosen, world=replace(chosen.world, adapters=some))
                rows[label] = run(part, driver, policy, ceiling, cores)
                advance(1.0)
    write_json({**summary, "ablation": rows} if ablation else summary, json)
    _show(summary)
    if ablation:
        _show_ablation({**rows, "all": summary})
    _show_episode(chosen, driver, episode, picture, video, replay)


def _show_ablation(rows: "Mapping[str, Summary]") -> None:
    cells = [
        [
            label,
            _share(found, "success"),
            share(found["reached"]),
            f"{1000.0 * found['mean_deviation_m']:.1f} mm",
        ]
        for label, found in rows.items()
    ]
    print_table("adapters", ["", " success", " reached", " deviation"], cells)


def _show(summary: "Summary") -> None:
    title = "{policy} on {task}, robot {robot}, {episodes} episodes of seed {seed}".format(
        **summary
    )
    rows = [
        ["goal reached without a kinematic failure", _share(summary, "success")],
        ["EE never more than 5 cm off, and at the goal", _share(summary, "within_5cm")],
        ["goal reached", share(summary["reached"])],
        ["kinematic failures an episode", f"{summary['ik_failures_per_episode']:.2f}"],
        ["EE deviation, mean", f"{1000 * summary['mean_deviation_m']:.1f} mm"],
        ["joint jumps an episode", f"{summary['joint_jumps_per_episode']:.2f}"],
        ["steps an episode", f"{summary['mean_steps']:.0f}"],
    ]
    if summary["ceiling"] is not None:
        rows.insert(1, ["ceiling: goals that some base pose reaches", _share(summary, "ceiling")])
    if (rms := summary["rms_deviation_m"]) is not None:
        rows += [
            ["followed without failure and joint jump", _share(summary, "smooth")],
            ["EE speed, share of the asked one", share(summary["speed_share"])],
            ["EE deviation, root mean square", f"{1000 * rms:.1f} mm"],
        ]
    if summary["collision_free_rate"] is not None:
        done = _share(summary, "task_success")
        rows += [
            ["task success", "no objects" if summary["task_success"] is None else done],
            ["episodes without a collision", share(summary["collision_free_rate"])],
            ["collisions of the base an episode", f"{summary['base_collisions']:.2f}"],
            ["collisions of the arm an episode", f"{summary['arm_collisions']:.2f}"],
        ]
    title += "" if summary["world"] == "analytic" else f", {summary['world']}"
    print_table(title, ["", " share (95 % interval) or mean"], rows)


def _share(summary: Mapping[str, Any], key: str) -> str:
    return share(*(summary[f"{key}{end}"] for end in ("", "_low", "_high")))


def _show_episode(
    chosen: "EvalConfig",
    policy: "Policy",
    number: int,
    picture: Path | None,
    video: Path | None,
    replay: Path | None,
) -> None:
    """Run an episode again and write it as picture, film and page."""
    if picture is None and video is None and replay is None:
        return
    from kinfeas.envs.world import World
    from kinfeas.viz.episodes import episodes_figure
    from kinfeas.viz.replay import run_episode
    from kinfeas.viz.style import png

    world = World(chosen.robot, chosen.task, chosen.world, chosen.seed)
    try:
        with status(f"episode {number}"):
            episode = run_episode(world, policy, number)
    finally:
        world.close()
    write_video(episode, video)
    if replay is not None:
        from kinfeas.viz.pages import replay_html

        write_drawing(lambda: replay_html(episode).encode(), replay)
    figure = partial(episodes_figure, chosen.robot, [episode.recording])
    write_drawing(lambda: png(figure(), dpi=110), picture)
