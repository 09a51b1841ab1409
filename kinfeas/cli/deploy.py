"""`kinfeas deploy` and `kinfeas servo`: run a policy on a robot or a simulated one."""

import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_facts, run_status, write_json
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.api.deploy import Deployment

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


def deploy(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.OptionalPolicy = None,
    robot: options.PolicyRobotName = None,
    plan: Path | None = option(
        None, "In place of policy and goal: a file of kinfeas plan.", metavar="FILE.csv"
    ),
    backend: options.RobotBackend = None,
    goal: Three | None = option(None, "EE goal in the world frame, metres.", metavar="X Y Z"),
    rpy: Three | None = option(None, "Orientation, rad.  [default: unchanged]", metavar="R P Y"),
    quaternion: Four | None = option(None, "Goal orientation as a quaternion.", metavar="X Y Z W"),
    generator: str | None = option(
        None, "Motion generator.  [default: linear; with a scene whole_body]"
    ),
    task: str | None = option(None, f"In place of --goal. {options.TASK}"),
    rate: options.Rate = 50.0,
    seconds: float = option(300.0, "Maximum duration.", min=0.0),
    seed: options.Seed = 0,
    record: options.Record = None,
    adapters: options.AdapterList = None,
    guards: options.GuardsFile = None,
    no_real_time: bool = option(False, "Simulate as fast as possible.", "--no-real-time"),
    filters: options.Filters = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Run a policy or a plan on a robot, behind guards, and record the run as CSV.

    Settings: guards.KEY, time_scale, head_start, arm_settle_timeout, ik.KEY, generator.KEY,
    task.KEY, backend.KEY, scene; see docs/deploy.md.

    Exit codes: 0 goal reached, 2 bad input, 3 stopped by a guard or an error, 4 --seconds exceeded
    or task not done, 128 + N signal N. The base is always stopped.

    Example: kinfeas deploy pr2.onnx --backend ros2 --goal 0.8 -0.2 0.9
    """
    from kinfeas.api import deploy as api

    with run_status() as on_moment:
        done = api.deploy(
            policy, plan=plan, robot=robot, backend=backend, goal=goal, rpy=rpy,
            quaternion=quaternion, generator=generator, task=task, rate=rate, seconds=seconds,
            seed=seed, record=record, adapters=adapters, guards=guards,
            real_time=not no_real_time, filters=filters, settings=options.read_settings(overrides),
            on_moment=on_moment,
        )  # fmt: skip
    raise typer.Exit(report(done, json))


def servo(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    backend: options.RobotBackend = None,
    source: str = option("ros2", "ros2, ros1, module:Class, plugin."),
    rate: options.Rate = 50.0,
    seconds: float = option(3600.0, "Duration of the run.", min=0.0),
    record: options.Record = None,
    adapters: options.AdapterList = None,
    guards: options.GuardsFile = None,
    filters: options.Filters = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Let base and arm follow EE poses or twists that arrive meanwhile.

    Settings: rules.KEY (limits of targets), source.KEY, generator.KEY, guards.KEY, ik.KEY,
    backend.KEY; see docs/teleoperation.md.

    Exit codes: 0 --seconds are over, others as of deploy.

    Example: kinfeas servo pretrained --robot pr2 --backend ros2 --source ros2
    """
    from kinfeas.api import servo as api

    with run_status(goal=False) as on_moment:
        done = api.servo(
            policy, robot=robot, backend=backend, source=source, rate=rate, seconds=seconds,
            record=record, adapters=adapters, guards=guards, filters=filters,
            settings=options.read_settings(overrides), on_moment=on_moment,
        )  # fmt: skip
    raise typer.Exit(report(done, json))


def report(done: "Deployment", json: Path | None) -> int:
    """Print the results of a run and return its code."""
    outcome, about = done.outcome, done.about
    code = int(outcome.code)
    facts = {**asdict(outcome), "code": code, **done.targets, "record": str(done.record)}
    title = f"{about.policy} on {about.task}, robot {about.robot}, {about.backend}"
    with suppress(OSError):  # of a terminal that was closed
        print_facts(title, {key: fact for key, fact in facts.items() if fact or fact == 0})
        if code:
            sys.stderr.write(f"stopped: {outcome.reason}\n")
        if outcome.unstopped:
            sys.stderr.write(f"the base could not be commanded to zero: {outcome.unstopped}\n")
        if outcome.unclosed:
            sys.stderr.write(f"could not be closed: {outcome.unclosed}\n")
    try:
        write_json(facts, json)
    except KinfeasError as error:  # keeps the exit code of the run
        sys.stderr.write(f"--json: {error}\n")
    return code
