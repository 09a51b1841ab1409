"""`kinfeas ceiling`: the share of goals that can be reached at all."""

from dataclasses import asdict
from typing import Annotated

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import percent, print_table, progress, write_json


def ceiling(  # noqa: PLR0913, PLR0917 - each option is an argument
    robot: options.RobotName = DEFAULT_ROBOT,
    task: options.TaskName = "ggr",
    episodes: options.Episodes = 500,
    seed: options.Seed = 1,
    path: Annotated[
        bool, option("Also check 16 poses on the way to each sub-goal.", "--path")
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
    from kinfeas.api import evaluate as api
    from kinfeas.kinematics.reachability import LIMITS

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
    rows = [[f"found with {count} base poses a goal", percent(value)] for count, value in stages]
    rows.append(["reachable", percent(bound.ceiling, bound.ceiling_low, bound.ceiling_high)])
    for number, limits in enumerate(bound.out_of_reach, 1):
        for limit, count in sorted(limits.items()):
            what = f"sub-goal {number} out of reach, {limit}: {LIMITS[limit]}"
            rows.append([what, percent(count / episodes)])
    print_table(title, ["", " share (95 % interval)"], rows)
