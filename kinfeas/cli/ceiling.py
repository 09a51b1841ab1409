"""`kinfeas ceiling`: how many goals can be reached at all."""

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, share, write_json


def ceiling(
    robot: options.RobotName = "pr2",
    task: options.TaskName = "ggr",
    episodes: options.Episodes = 500,
    seed: options.Seed = 1,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Show the share of goals that some base pose can reach: what no policy can beat.

    The goals are those that [bold]kinfeas evaluate[/] draws with the same seed. Settings:
    [bold]ik.KEY[/], such as [bold]ik.self_collision=false[/], and [bold]task.KEY[/], the task's own
    parameters, such as [bold]task.orientation=so3[/].
    """
    from kinfeas.evaluation.ceiling import CeilingConfig, measure_ceiling
    from kinfeas.kinematics.ceiling import STAGES

    config = options.read_overrides(CeilingConfig, overrides)
    known, drawn_by = options.read_robot(robot), options.read_task(task, config.task)
    with progress(f"{episodes} goals") as advance:
        found = measure_ceiling(known, drawn_by, episodes, seed, config.ik, advance)
    summary = {
        "robot": known.name,
        "task": drawn_by.name,
        "seed": seed,
        "episodes": episodes,
        "ceiling": found.share.value,
        "ceiling_low": found.share.low,
        "ceiling_high": found.share.high,
        "base_poses": list(STAGES),
        "convergence": list(found.convergence),
    }
    if json is not None:
        write_json(summary, json)
    title = f"ceiling of {drawn_by.name}, robot {known.name}, {episodes} goals of seed {seed}"
    stages = zip(STAGES, found.convergence, strict=True)
    rows = [[f"found with {tries} base poses a goal", share(value)] for tries, value in stages]
    interval = share(found.share.value, found.share.low, found.share.high)
    rows.append(["share of goals that can be reached", interval])
    print_table(title, ["", " share (95 % interval)"], rows)
