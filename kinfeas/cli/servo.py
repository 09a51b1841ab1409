"""`kinfeas servo`: base and arm follow EE targets that arrive while the robot runs."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.deploy import check_record, make_setup, read_settings, run_and_report
from kinfeas.cli.output import status
from kinfeas.core.errors import PLUGIN_ERRORS, describe, plugin_note

if TYPE_CHECKING:
    from kinfeas.sim2real.servo import TargetSource
    from kinfeas.sim2real.servo.controller import TargetController

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
    from kinfeas.sim2real.deploy.runtime import Code
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
    name, code = f"target source {source!r}", 0
    with _watched(name, controller):
        try:
            with plugin_note(name):
                targets.start(controller)
            code = run_and_report(
                setup, robot, policy, backend, record, json, controller.statistics
            )
        finally:
            try:
                targets.close()
            except PLUGIN_ERRORS as error:
                sys.stderr.write(f"{name} could not be closed: {describe(error)}\n")
                code = code or Code.FAULT
    raise typer.Exit(int(code))


@contextmanager
def _watched(name: str, controller: "TargetController") -> Iterator[None]:
    """End the run of a controller if a thread that starts meanwhile raises an exception."""
    others, hook = set(threading.enumerate()), threading.excepthook

    def failed(arguments: threading.ExceptHookArgs) -> None:
        hook(arguments)
        if arguments.thread not in others:
            raised = f"{arguments.exc_type.__name__}: {arguments.exc_value}"
            controller.fail(f"a thread of {name} raised {raised}")

    threading.excepthook = failed
    try:
        yield
    finally:
        threading.excepthook = hook


def _build_source(name: str, parameters: dict[str, object]) -> "TargetSource":
    """Return a source by its entry point or as `module:Class`, also of the working directory."""
    from kinfeas.core import registry

    if ":" not in name:
        return registry.build(GROUP, name, parameters)
    sys.path.append(str(Path.cwd()))
    return registry.build_target(GROUP, name, parameters)
