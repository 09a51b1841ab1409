"""`kinfeas play`: a page on which a simulated robot follows a target that one drags."""

from pathlib import Path
from typing import Annotated

import typer

from kinfeas.cli import options
from kinfeas.core.extras import require


def play(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    second_policy: Annotated[
        str, typer.Option(help="Policy of a second robot with the same target.")
    ] = "none",
    generator: Annotated[
        str,
        typer.Option(
            help="servo follows the handle; other generators start when it is released.",
            autocompletion=options.names_of("motion_generators"),
        ),
    ] = "servo",
    filters: Annotated[
        str, typer.Option(metavar="NAMES", help="Such as path_planner,feasibility, or none.")
    ] = "time_scaling",
    backend: Annotated[
        str,
        typer.Option(
            help="analytic, pybullet or mujoco.", autocompletion=options.names_of("backends")
        ),
    ] = "analytic",
    scene: Annotated[str, typer.Option(help="Scene by name or YAML file, or none.")] = "room",
    demonstrations: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder of the recorded motions.")
    ] = Path("demonstrations"),
    host: Annotated[str, typer.Option(help="Address; 0.0.0.0 for other computers.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for a free one.")] = 8080,
) -> None:
    """Drag the target of a simulated robot in the browser; base and arm follow.

    Example: kinfeas play --robot pr2 --backend mujoco
    """
    require("viser", "fcl")
    from kinfeas.viz.choice import Choice
    from kinfeas.viz.server import serving

    with serving("kinfeas play", host, port) as server:
        if server.get_port() != port != 0:
            typer.echo(f"port {port} is in use; this page is at {server.get_port()}", err=True)
        typer.echo(server.url)  # browsers load while the rest is imported
        from kinfeas.viz.play import play as run

        choice = Choice(
            robot or options.robot_of(policy), policy, second_policy, generator,
            tuple(options.filter_names(filters)), backend, scene,
        )  # fmt: skip
        run(server, choice, demonstrations)
