"""`kinfeas evaluate`: how well a policy does."""

from typing import TYPE_CHECKING

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, share, write_json

if TYPE_CHECKING:
    from kinfeas.evaluation.evaluate import Summary


def evaluate(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyName,
    robot: options.RobotName = "pr2",
    task: options.TaskName = "ggr",
    episodes: options.Episodes = 500,
    seed: options.Seed = 1,
    processes: options.Processes = 1,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Run a policy's episodes and show its figures beside the ceiling that no policy can beat.

    Settings: [bold]world.KEY[/] (dt, max_failures, max_steps, adapters, ik) and [bold]task.KEY[/],
    the task's own parameters, such as [bold]task.orientation=so3[/].
    """
    from kinfeas.evaluation.evaluate import EvaluationConfig, Trial, trial_ceiling
    from kinfeas.evaluation.evaluate import evaluate as run
    from kinfeas.evaluation.policies import load_policy

    config = options.read_overrides(EvaluationConfig, overrides)
    known = options.read_robot(robot)
    trial = Trial(known, options.read_task(task, config.task), episodes, seed, config.world)
    driver = load_policy(policy, known)
    with progress("ceiling") as advance:
        ceiling = trial_ceiling(trial, advance)
    with progress(f"{episodes} episodes", episodes) as advance:
        summary = run(trial, driver, policy, ceiling, processes, advance)
    if json is not None:
        write_json(summary, json)
    _show(summary)


def _show(summary: "Summary") -> None:
    title = "{policy} on {task}, robot {robot}, {episodes} episodes of seed {seed}".format(
        **summary
    )
    rows = [
        ["goal reached without a kinematic failure", _share(summary, "success")],
        ["ceiling: goals that some base pose reaches", _share(summary, "ceiling")],
        ["EE never more than 5 cm off, and at the goal", _share(summary, "within_5cm")],
        ["goal reached", share(_number(summary, "reached"))],
        ["kinematic failures an episode", f"{_number(summary, 'mean_failures'):.2f}"],
        ["EE deviation, mean", f"{1000 * _number(summary, 'mean_deviation_m'):.1f} mm"],
        ["arm jumps an episode", f"{_number(summary, 'jumps_per_episode'):.2f}"],
        ["steps an episode", f"{_number(summary, 'mean_steps'):.0f}"],
    ]
    print_table(title, ["", " share (95 % interval) or mean"], rows)


def _share(summary: "Summary", key: str) -> str:
    return share(*(_number(summary, f"{key}{end}") for end in ("", "_low", "_high")))


def _number(summary: "Summary", key: str) -> float:
    return float(summary[key] or 0.0)
