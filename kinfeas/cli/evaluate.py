"""`kinfeas evaluate`: how well a policy does."""

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, progress, share, write_json
from kinfeas.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.evaluation.evaluate import Summary

_EPISODES = {"analytic": 500, "pybullet": 50}


class WorldName(StrEnum):
    """Where the episodes happen."""

    ANALYTIC = "analytic"
    PYBULLET = "pybullet"


def evaluate(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyName,
    robot: options.RobotName = "pr2",
    task: options.TaskName = "ggr",
    world: Annotated[
        WorldName, typer.Option("--world", help="Without or with inertia, motors and contacts.")
    ] = WorldName.ANALYTIC,
    episodes: Annotated[
        int | None,
        typer.Option(
            "--episodes",
            min=1,
            help="Number of episodes.",
            show_default="500, with physics 50",
        ),
    ] = None,
    seed: options.Seed = 1,
    head_start: Annotated[
        float | None,
        typer.Option(
            "--head-start",
            metavar="SECONDS",
            help="pybullet: how long the base moves before the EE does.",
            show_default="0",
        ),
    ] = None,
    slow_down: Annotated[
        float | None,
        typer.Option(
            "--slow-down",
            metavar="FACTOR",
            help="pybullet: how many times longer than planned EE motions last.",
            show_default="2 for pr2, else 1",
        ),
    ] = None,
    without_objects: Annotated[
        bool, typer.Option("--without-objects", help="pybullet: an empty floor, no furniture.")
    ] = False,
    gui: Annotated[bool, typer.Option("--gui", help="pybullet: show it in a window.")] = False,
    processes: options.Processes = 1,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Run a policy's episodes and show its figures beside the ceiling that no policy can beat.

    Settings: [bold]world.KEY[/] (dt, max_failures, max_steps, adapters, ik; with physics dt,
    max_failures, max_seconds, adapters, ik, physics) and [bold]task.KEY[/], the task's own
    parameters, such as [bold]task.orientation=so3[/].
    """
    said = {"--head-start": head_start, "--slow-down": slow_down}
    said |= {"--without-objects": without_objects or None, "--gui": gui or None}
    given = [name for name, value in said.items() if value is not None]
    count = episodes or _EPISODES[world]
    if world is WorldName.ANALYTIC:
        if given:
            raise KinfeasError(f"{given[0]} needs --world pybullet")
        summary = _analytic((policy, robot, task), count, seed, processes, overrides)
    else:
        wishes = {"head_start": head_start, "slow_down": slow_down}
        wishes["objects"] = False if without_objects else None
        assignments = [f"world.{key}={value}" for key, value in wishes.items() if value is not None]
        assignments += overrides or []
        summary = _physics((policy, robot, task), count, seed, processes, assignments, gui=gui)
    if json is not None:
        write_json(summary, json)
    _show(summary)


def _analytic(
    names: tuple[str, str, str],
    episodes: int,
    seed: int,
    processes: int,
    overrides: list[str] | None,
) -> "Summary":
    from kinfeas.evaluation.evaluate import EvaluationConfig, Trial, trial_ceiling
    from kinfeas.evaluation.evaluate import evaluate as run
    from kinfeas.evaluation.policies import load_policy

    policy, robot, task = names
    config = options.read_overrides(EvaluationConfig, overrides)
    known = options.read_robot(robot)
    trial = Trial(known, options.read_task(task, config.task), episodes, seed, config.world)
    driver = load_policy(policy, known)
    with progress("ceiling") as advance:
        ceiling = trial_ceiling(trial, advance)
    with progress(f"{episodes} episodes", episodes) as advance:
        return run(trial, driver, policy, ceiling, processes, advance)


def _physics(
    names: tuple[str, str, str],
    episodes: int,
    seed: int,
    processes: int,
    overrides: list[str],
    *,
    gui: bool,
) -> "Summary":
    from kinfeas.evaluation.evaluate import Trial, trial_ceiling
    from kinfeas.evaluation.physics import evaluate_physics
    from kinfeas.evaluation.physics_world import PhysicsTrial, physics_config
    from kinfeas.evaluation.policies import load_policy

    policy, robot, task = names
    known = options.read_robot(robot)
    config = physics_config(known, overrides)
    trial = PhysicsTrial(known, options.read_task(task, config.task), episodes, seed, config.world)
    driver = load_policy(policy, known)
    with progress("ceiling") as advance:
        drawn = Trial(known, trial.task, episodes, seed, config.world.world)
        ceiling = trial_ceiling(drawn, advance)
    with progress(f"{episodes} episodes", episodes) as advance:
        return evaluate_physics(trial, driver, policy, ceiling, processes, advance, gui=gui)


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
    if summary.get("world") == WorldName.PYBULLET:
        title += ", PyBullet"
        rows += [
            ["task done", _task_success(summary)],
            ["episodes without a collision", share(_number(summary, "free_of_collisions"))],
            ["collisions of the base an episode", f"{_number(summary, 'base_collisions'):.2f}"],
            ["collisions of the arm an episode", f"{_number(summary, 'arm_collisions'):.2f}"],
        ]
    print_table(title, ["", " share (95 % interval) or mean"], rows)


def _task_success(summary: "Summary") -> str:
    return "no objects" if summary["task_success"] is None else _share(summary, "task_success")


def _share(summary: "Summary", key: str) -> str:
    return share(*(_number(summary, f"{key}{end}") for end in ("", "_low", "_high")))


def _number(summary: "Summary", key: str) -> float:
    return float(summary[key] or 0.0)
