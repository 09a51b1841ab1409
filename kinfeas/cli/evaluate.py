"""`kinfeas evaluate`: how well a policy does."""

from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinfeas.cli import inputs, options
from kinfeas.cli.filming import Episode, Replay, Video, show_episode, shown_episode
from kinfeas.cli.output import (
    check_file_path,
    check_outputs,
    print_table,
    progress,
    say_written,
    share,
    write_json,
)
from kinfeas.cli.physics_options import physics_assignments
from kinfeas.cli.policy_robot import check_policy, robot_of
from kinfeas.cli.sim2real_table import weigh
from kinfeas.config.quantities import MOST_EPISODES
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.evaluation.evaluate import Summary
    from kinfeas.evaluation.sim2real import Specs

    OnDone = Callable[[int], None]


class WorldName(StrEnum):
    """Where the episodes happen."""

    ANALYTIC = "analytic"
    PYBULLET = "pybullet"


def evaluate(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyName,
    robot: options.PolicyRobotName = None,
    task: options.TaskName = "ggr",
    world: Annotated[
        WorldName,
        typer.Option(
            "--world",
            help="analytic: without physics; pybullet: with inertia, motors and contacts.",
        ),
    ] = WorldName.ANALYTIC,
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes",
            min=1,
            max=MOST_EPISODES,
            help="Number of episodes; by default 500, with physics 50.",
        ),
    ] = None,
    seed: options.Seed = 1,
    head_start: Annotated[
        float | None,
        typer.Option(
            "--head-start",
            metavar="SECONDS",
            help="pybullet: how long the base moves before the EE does, 0 or more; by default 0.",
        ),
    ] = None,
    time_scale: Annotated[
        float | None,
        typer.Option(
            "--time-scale",
            metavar="SHARE",
            help="pybullet: speed of EE motions as a share of the planned one, 0.001 to 1; by "
            "default 0.5 for pr2, else 1.",
        ),
    ] = None,
    without_objects: Annotated[
        bool, typer.Option("--no-objects", help="pybullet: an empty floor, no furniture.")
    ] = False,
    filters: options.Filters = None,
    gui: Annotated[bool, typer.Option("--gui", help="pybullet: show it in a window.")] = False,
    sim2real: options.Sim2RealName = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--picture",
            help="Draw an episode into this PNG; with --adapters what that costs, and success "
            "against latency, noise and head start, which takes fifteen evaluations more.",
            callback=check_file_path,
        ),
    ] = None,
    video: Video = None,
    replay: Replay = None,
    episode: Episode = None,
    processes: options.Processes = 1,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Run a policy's episodes and show its figures beside the ceiling that no policy can beat.

    Settings: [bold]world.KEY[/], [bold]task.KEY[/], the task's own parameters, such as
    [bold]task.orientation=so3[/]. An unknown KEY is answered by those that
    there are.

    The analytic world has dt=0.1 s, max_failures=19, max_seconds=150 s, adapters, ik,
    filters=[], and reward, which changes no figure. PyBullet's has dt=0.02 s,
    max_failures=99, max_seconds=150 s, adapters, ik, filters (those of the robot), physics,
    arm_settle_timeout=8 s, time_scale=1 (0.5 for pr2),
    head_start=0 s, and objects=true.

    With [bold]--adapters[/] the figures are those within all its adapters, and a table says what
    each of them costs alone, and what the others cost without it.

    [bold]--video[/], [bold]--replay[/] and [bold]--picture[/] show one episode: the desired path
    of the EE dashed, the achieved one green, steps without an IK solution red.
    """
    options.check_robot(robot)
    check_policy(policy)
    from kinfeas.evaluation.evaluate import default_episodes, prepare, reachability_of
    from kinfeas.evaluation.evaluate import evaluate as run_evaluation

    outputs = {"--json": json, "--picture": picture, "--video": video, "--replay": replay}
    read = {"--robot": robot, "--task": task, "--adapters": sim2real}
    sources = {option: inputs.named(name) for option, name in read.items()}
    sources |= {"--policy": inputs.of_policy(policy), "--set": inputs.of_settings(overrides)}
    check_outputs(outputs, sources)
    if robot is None:
        robot = robot_of(policy)
        check_outputs(outputs, {"--policy": inputs.named(robot)})
    adapters = _adapters(sim2real, robot) if sim2real is not None else ()
    said: dict[str, object] = {"--head-start": head_start, "--time-scale": time_scale}
    said |= {"--no-objects": without_objects or None, "--gui": gui or None}
    given = [name for name, value in said.items() if value is not None]
    count = episodes or default_episodes(world)
    if world is WorldName.ANALYTIC and given:
        raise KinfeasError(f"{given[0]} needs --world pybullet")
    shown = {**outputs, "--picture": picture if sim2real is None else None, "--json": None}
    number = shown_episode(episode, count, shown=any(shown.values()))
    assignments = options.with_filters(filters, overrides or [])
    if world is WorldName.PYBULLET:
        assignments = physics_assignments(head_start, time_scale, without_objects, assignments)
        if gui:
            assignments, processes = [*assignments, "world.backend_parameters.gui=true"], 1
    chosen, driver = prepare(
        policy, robot, task, world, episodes=count, seed=seed, overrides=assignments
    )
    with progress("ceiling") as advance:
        ceiling = reachability_of(chosen, advance)

    def run(some: "Specs", on_done: "OnDone | None") -> "Summary":
        return run_evaluation(chosen.within(some), driver, policy, ceiling, processes, on_done)

    if sim2real is None:
        with progress(f"{count} episodes", count) as advance:
            summary = run((), advance)
        if json is not None:
            write_json(summary, json)
        _show(summary)
    else:
        summary, held, show = weigh(lambda some: run(some, None), sim2real, adapters, picture)
        if json is not None:
            write_json({**summary, **held}, json)
        _show(summary)
        show()
        say_written(picture)
    show_episode(chosen.within(adapters), driver, number, shown)


def _adapters(sim2real: str, robot: str) -> "Specs":
    """Return the adapters of a list, after a check that they can be built."""
    from kinfeas.evaluation.evaluate import check_adapters

    adapters = options.read_adapters(sim2real)
    check_adapters(adapters, options.read_robot(robot))
    return adapters


def _show(summary: "Summary") -> None:
    title = "{policy} on {task}, robot {robot}, {episodes} episodes of seed {seed}".format(
        **summary
    )
    rows = [
        ["goal reached without a kinematic failure", _share(summary, "success")],
        ["ceiling: goals that some base pose reaches", _share(summary, "ceiling")],
        ["EE never more than 5 cm off, and at the goal", _share(summary, "within_5cm")],
        ["goal reached", share(summary["reached"])],
        ["kinematic failures an episode", f"{summary['ik_failures_per_episode']:.2f}"],
        ["EE deviation, mean", f"{1000 * summary['mean_deviation_m']:.1f} mm"],
        ["joint jumps an episode", f"{summary['joint_jumps_per_episode']:.2f}"],
        ["steps an episode", f"{summary['mean_steps']:.0f}"],
    ]
    if summary.get("world") == WorldName.PYBULLET:
        title += ", PyBullet"
        rows += _physics_rows(summary)
    print_table(title, ["", " share (95 % interval) or mean"], rows)


def _physics_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    without_objects = summary["task_success"] is None
    return [
        ["task done", "no objects" if without_objects else _share(summary, "task_success")],
        ["episodes without a collision", share(summary["collision_free_rate"])],
        ["collisions of the base an episode", f"{summary['base_collisions']:.2f}"],
        ["collisions of the arm an episode", f"{summary['arm_collisions']:.2f}"],
    ]


def _share(summary: Mapping[str, Any], key: str) -> str:
    return share(*(summary[f"{key}{end}"] for end in ("", "_low", "_high")))
