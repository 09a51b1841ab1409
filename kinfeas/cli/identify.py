"""`kinfeas identify`: a robot's response and noise from records of its runs."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kinfeas.cli import options
from kinfeas.cli.deploy import report
from kinfeas.cli.options import argument, option
from kinfeas.cli.output import print_paths, print_table, run_status, status, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_new

if TYPE_CHECKING:
    from kinfeas.api.identify import Identified


def identify(  # noqa: PLR0913, PLR0917 - each option is an argument
    records: list[Path] | None = argument(
        None, "Records of kinfeas deploy or of --drive, or bags of ROS.", metavar="[RECORD]..."
    ),
    robot: str | None = option(None, f"{options.ROBOT}  [default: that of the record]"),
    out: Path | None = options.file_option(None, "New file of adapters.", ".yaml", ".yml"),
    picture: options.Picture = None,
    prior: str = option("harsh", "Adapters whose drift of localisation is assumed."),
    drive: bool = option(False, "Drive a pattern of a minute, and record it.", "--drive"),
    backend: options.RobotBackend = None,
    record: options.Record = None,
    adapters: str | None = option(None, "Adapters of a simulated robot that is driven."),
    rate: options.Rate = 50.0,
    seed: options.Seed = 0,
    no_real_time: bool = option(False, "Simulate as fast as possible.", "--no-real-time"),
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Fit latencies, lags, limits and noise to records of a robot.

    The file of --out is for --adapters of train, evaluate and deploy; ranges are 95 % intervals.
    With --drive the base moves by up to 0.5 m and the arm by 0.4 rad, behind the guards; settings
    are those of deploy, such as guards.KEY. What was recorded is then fitted.

    Exit codes: 0, 2 bad input; of --drive those of deploy.

    Example: kinfeas identify runs/deploy/FILE.csv --out my_robot.yaml --picture fit.png
    """
    check_new(out)
    paths = list(records or ())
    if drive and paths:
        raise KinfeasError("--drive records by itself and excludes records")
    if not drive and (backend or record or adapters or overrides):
        raise KinfeasError("--backend, --record, --adapters and --set need --drive")
    from kinfeas.api import DEFAULT_ROBOT
    from kinfeas.api import identify as api

    if drive:
        with run_status(goal=False) as on_moment:
            done = api.drive(
                robot or DEFAULT_ROBOT, backend=backend, record=record, adapters=adapters,
                rate=rate, seed=seed, real_time=not no_real_time,
                settings=options.read_settings(overrides), on_moment=on_moment,
            )  # fmt: skip
        if code := report(done, None):
            raise typer.Exit(code)
        paths = [done.record]
    with status("fitting"):
        identified = api.identify(paths, robot, out=out, picture=picture, prior=prior)
    _print(identified)
    write_json(identified.facts(), json)
    print_paths(out, picture)


def _print(identified: "Identified") -> None:
    rows = [
        [name, *(f"{value:.3g}" for value in (each.value, each.low, each.high))]
        for name, each in identified.estimates.items()
    ]
    print_table(f"robot {identified.robot}", ["parameter", " estimate", " low", " high"], rows)
    for sentence in identified.missing:
        typer.echo(f"* {sentence}")
    typer.echo(f"\nFor the robot's robot.yaml:\n\n{identified.response_lines}")
