"""`kinfeas play`: a page on which a simulated robot follows a target that one drags."""

from pathlib import Path
from typing import Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.core.extras import require


def play(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    second_policy: Annotated[
        str, option("Policy of a second robot with the same target.")
    ] = "none",
    generator: Annotated[
        str,
        option(
            "servo follows the handle; other generators start when it is released.",
            groups=("motion_generators",),
        ),
    ] = "servo",
    filters: Annotated[
        str, option("Such as path_planner,feasibility, or none.", metavar="NAMES")
    ] = "time_scaling",
    backend: Annotated[
        str, option("analytic, pybullet or mujoco.", groups=("backends",))
    ] = "analytic",
    scene: Annotated[str, option("Scene by name or YAML file, or none.")] = "room",
    demonstrations: Annotated[
        Path, option("Folder of the recorded motions.", metavar="FOLDER")
    ] = Path("demonstrations"),
    host: Annotated[str, option("Address; 0.0.0.0 for other computers.")] = "127.0.0.1",
    port: Annotated[int, option("Port; 0 for a free one.", min=0, max=65535)] = 8080,
) -> None:
    """Drag the target of a simulated robot in the browser; base and arm follow.

    Example: kinfeas play --robot pr2 --backend mujoco
    """
    require("viser", "fcl")
    from kinfeas.viz.server import serving

    with serving("kinfeas play", host, port) as server:
        typer.echo(server.url)  # browsers load while the rest is imported
        from kinfeas.api.load import filter_names, robot_of
        from kinfeas.viz.live import Choice
        from kinfeas.viz.play import play as run

        names = filter_names(filters)
        choice = Choice(
            robot or robot_of(policy), policy, second_policy, generator, names, backend, scene
        )
        run(server, choice, demonstrations)
