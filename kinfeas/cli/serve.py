"""`kinfeas serve`: answers of reach and plan over HTTP and ROS 2."""

import typer

from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import status


def serve(
    robot: options.RobotName = "pr2",
    scene: str | None = option(None, "Scene by name or YAML file, whose furniture is avoided."),
    port: int = option(8081, "Port; 0 for a free one.", min=0, max=65535),
    ros2: bool = option(False, "Also answer ROS 2 nodes on the network.", "--ros2"),
) -> None:
    """Answer POST /reach and POST /plan with JSON, for programs on this computer, until Ctrl-C.

    Example: kinfeas serve --robot pr2 --scene room
    """
    from kinfeas.api.serve import PlanningServer

    with status("preparing"):
        server = PlanningServer(robot, scene, port, ros2=ros2)
    typer.echo(server.url)
    with server:
        server.serve_forever()
