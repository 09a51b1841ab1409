"""`kinfeas ceiling`: how many goals can be reached at all."""

from typing import Annotated

import typer

from kinfeas.cli import inputs, options
from kinfeas.cli.output import check_outputs, print_table, progress, share, write_json


def ceiling(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = "pr2",
    task: options.TaskName = "ggr",
    episodes: options.Episodes = 500,
    seed: options.Seed = 1,
    path: Annotated[
        bool, typer.Option("--path", help="Ask for the poses along the way as well, 16 a sub-goal.")
    ] = False,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Show the share of goals that some base pose can reach: what no policy can beat.

    The goals are those that [bold]kinfeas evaluate[/] draws with the same seed; where an episode
    has several sub-goals, the goals of all of them count as one. Settings:
    [bold]ik.KEY[/], such as [bold]ik.self_collision=false[/], and [bold]task.KEY[/], the task's own
    parameters, such as [bold]task.orientation=so3[/].
    """
    options.check_robot(robot)
    from kinfeas.evaluation.reachability import (
        ReachabilityConfig,
        measure_path_reachability,
        measure_reachability,
    )
    from kinfeas.kinematics.reachability import STAGES

    read = {"--robot": robot, "--task": task}
    sources = {option: inputs.named(name) for option, name in read.items()}
    check_outputs({"--json": json}, {**sources, "--set": inputs.of_settings(overrides)})
    config = options.read_overrides(ReachabilityConfig, overrides)
    known, drawn_by = options.read_robot(robot), options.read_task(task, config.task)
    with progress(f"{episodes} goals") as advance:
        measure = measure_path_reachability if path else measure_reachability
        found = measure(known, drawn_by, episodes, seed, config.ik, advance)
    summary = {
        "robot": known.name,
        "task": drawn_by.name,
        "seed": seed,
        "episodes": episodes,
        "path": path,
        "ceiling": found.share.value,
        "ceiling_low": found.share.low,
        "ceiling_high": found.share.high,
        "base_poses": list(STAGES),
        "convergence": list(found.convergence),
    }
    if json is not None:
        write_json(summary, json)
    what = f"{drawn_by.name}{', the way there included' if path else ''}"
    title = f"ceiling of {what}, robot {known.name}, {episodes} goals of seed {seed}"
    stages = zip(STAGES, found.convergence, strict=True)
    rows = [[f"found with {tries} base poses a goal", share(value)] for tries, value in stages]
    interval = share(found.share.value, found.share.low, found.share.high)
    rows.append(["share of goals that can be reached", interval])
    print_table(title, ["", " share (95 % interval)"], rows)
