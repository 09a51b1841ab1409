"""`kinfeas servo`: base and arm follow EE targets that arrive while the robot runs."""

from typing import Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.deploy import report
from kinfeas.cli.options import option
from kinfeas.cli.output import status


def servo(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    backend: options.RobotBackend = None,
    source: Annotated[
        str, option("ros2, ros1, module:Class, or a plugin.", groups=("target_sources",))
    ] = "ros2",
    rate: options.Rate = 50.0,
    seconds: Annotated[float, option("Duration of the run.", min=0.0)] = 3600.0,
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

    with status("preparing") as preparing:
        done = api.servo(
            policy, robot=robot, backend=backend, source=source, rate=rate, seconds=seconds,
            record=record, adapters=adapters, guards=guards, filters=filters,
            settings=options.read_settings(overrides), on_start=preparing.stop,
        )  # fmt: skip
    raise typer.Exit(report(done, json))
