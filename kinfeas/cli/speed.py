"""`kinfeas speed`: run times on this machine."""

from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_table, share, status, write_json
from kinfeas.core.extras import require

if TYPE_CHECKING:
    from kinfeas.benchmark.speed import Figure


def speed(
    robot: options.RobotName = options.DEFAULT_ROBOT,
    to_level: Annotated[
        bool,
        typer.Option(
            "--to-level",
            help="Also train the whole recipe: seconds to 70, 80 and 90 % of the ceiling.",
        ),
    ] = False,
    json: options.JsonPath = None,
) -> None:
    """Time IK, environments, policy and training.

    IK is timed beside Pinocchio and PyBullet. Figures are the best of several repeats on one core.
    The policy has random weights. Training uses the robot's recipe on all cores for half a minute.
    Steps are control periods. With --to-level the recipe trains to its end, with an evaluation
    every five seconds, which does not count as training time.

    Example: kinfeas speed --robot hsr
    """
    from kinfeas.benchmark.speed import measure_speed

    require("torch", "stable_baselines3")
    with status("speed") as show:
        figures = measure_speed(
            robot, on_part=lambda part: show(f"timing: {part}"), to_level=to_level
        )
    write_json({figure.key: figure.value for figure in figures if figure.key}, json)
    rows = [[figure.text, _text(figure)] for figure in figures]
    print_table(f"speed, robot {robot}", ["", " on this machine"], rows)


def _text(figure: "Figure") -> str:
    if figure.value is None:
        return "not reached" if figure.unit == "s" else "not installed"
    if not figure.unit:
        return share(figure.value)
    return f"{figure.value:,.{0 if figure.value >= 1000 else 2}f} {figure.unit}"
