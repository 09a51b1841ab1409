"""`kinfeas ceiling`: the share of goals that can be reached at all."""

from typing import Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, share, write_json


def ceiling(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = options.DEFAULT_ROBOT,
    task: options.TaskName = "ggr",
    episodes: options.Episodes = 500,
    seed: options.Seed = 1,
    path: Annotated[
        bool, typer.Option("--path", help="Also check 16 poses on the way to each sub-goal.")
    ] = False,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Compute the share of reachable goals. It is an upper bound for every policy.

    The goals are those of kinfeas evaluate with the same seed. All sub-goals of an episode count as
    one; those out of reach are listed with the reason. Settings: ik.KEY, such as
    ik.self_collision=false, and task.KEY, the task's parameters.

    Example: kinfeas ceiling --robot pr2 --task door --path --episodes 100
    """
    from kinfeas.config import from_mapping
    from kinfeas.evaluation.reachability import ReachabilityConfig, measure_reachability
    from kinfeas.planning.placement import LIMITS, STAGES

    config = from_mapping(ReachabilityConfig, {}, "settings", overrides or ())
    known, drawn_by = options.read_robot(robot), options.read_task(task, config.task)
    with progress(f"{episodes} goals") as advance:
        found = measure_reachability(
            known, drawn_by, episodes, seed, config.ik, advance, path=path, limits=True
        )
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
        "out_of_reach": list(found.limits),
    }
    write_json(summary, json)
    what = f"{drawn_by.name}{', path included' if path else ''}"
    title = f"ceiling of {what}, robot {known.name}, {episodes} goals of seed {seed}"
    stages = zip(STAGES, found.convergence, strict=True)
    rows = [[f"found with {count} base poses a goal", share(value)] for count, value in stages]
    rows.append(["reachable", share(found.share.value, found.share.low, found.share.high)])
    for number, limits in enumerate(found.limits, 1):
        for limit, count in sorted(limits.items()):
            what = f"sub-goal {number} out of reach, {limit}: {LIMITS[limit]}"
            rows.append([what, share(count / episodes)])
    print_table(title, ["", " share (95 % interval)"], rows)
