"""`kinfeas servo`: base and arm follow EE targets that arrive while the robot runs."""

import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.deploy import check_record, make_setup, read_settings, run_and_report
from kinfeas.cli.output import status

if TYPE_CHECKING:
    from kinfeas.sim2real.servo import TargetSource

GROUP = "kinfeas.target_sources"


def servo(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    backend: options.RobotBackend = None,
    source: Annotated[
        str,
        typer.Option(
            help="ros2, ros1, module:Class, or a plugin.",
            autocompletion=options.names_of("target_sources"),
        ),
    ] = "ros2",
    rate: options.Rate = 50.0,
    seconds: Annotated[float, typer.Option(min=0.0, help="Duration of the run.")] = 3600.0,
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
    from kinfeas.config.recipes import default_engine
    from kinfeas.sim2real.deploy.config import ServoConfig
    from kinfeas.sim2real.servo.controller import ServoTask, TargetController
    from kinfeas.tasks.task import MotionSpec

    check_record(record)
    with status("preparing"):
        robot, backend = robot or options.robot_of(policy), backend or default_engine()
        known = options.read_robot(robot)
        changes = options.with_filters(filters, overrides or [], "")
        config = read_settings(ServoConfig, "servo", known, guards, changes)
        controller = TargetController(known, config.rules)
        task = ServoTask(
            controller, MotionSpec("servo", {**config.rules.generator_limits, **config.generator})
        )
        targets = _build_source(source, config.source)
        setup = make_setup(
            policy, backend, known, task, config, adapters=options.read_adapters(adapters),
            dt=1.0 / rate, seconds=seconds, seed=0, real_time=True,
        )  # fmt: skip
        setup = replace(setup, filters=(controller, *setup.filters))
    with closing(targets):
        targets.start(controller)
        run_and_report(setup, robot, policy, backend, record, json)


def _build_source(name: str, parameters: dict[str, object]) -> "TargetSource":
    """Return a source by its entry point or as `module:Class`, also of the working directory."""
    from kinfeas.core import registry

    if ":" not in name:
        return registry.build(GROUP, name, parameters)
    sys.path.append(str(Path.cwd()))
    return registry.build_target(GROUP, name, parameters)
