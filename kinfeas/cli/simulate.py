"""`kinfeas simulate`: a robot for those who have none."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from kinfeas.cli import inputs, options
from kinfeas.cli.output import check_outputs, print_table, write_json
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.sim2real.simulator.playing import Played


def simulate(  # noqa: PLR0913, PLR0917 - each option is an argument
    backend: Annotated[
        str,
        typer.Option(
            "--backend", help="Bus on which to play the robot: ros2, ros1, or a plugin that can."
        ),
    ] = "ros2",
    robot: options.RobotName = "pr2",
    task: Annotated[
        str | None, typer.Option("--task", help="Begin as in an episode of this task.")
    ] = None,
    episode: Annotated[int, typer.Option("--episode", min=0, help="Number of that episode.")] = 0,
    seed: options.Seed = 0,
    scene: Annotated[
        str | None,
        typer.Option("--scene", help="Scene by name (room) or path of its YAML; or a task's own."),
    ] = None,
    topics: Annotated[
        str | None,
        typer.Option("--topics", help="YAML of the robot's names on the bus; by default its own."),
    ] = None,
    rate: Annotated[
        float, typer.Option("--rate", min=10.0, max=1000.0, help="Measurements per second, Hz.")
    ] = 100.0,
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", min=0.0, help="Seconds after which it ends; by default never."),
    ] = None,
    command_timeout: Annotated[
        float,
        typer.Option(
            "--command-timeout",
            min=0.0,
            help="Seconds without a command after which the base stops by itself.",
        ),
    ] = 0.25,
    gui: Annotated[bool, typer.Option("--gui", help="Show it in a window.")] = False,
    json: options.JsonPath = None,
) -> None:
    """Play a robot in the PyBullet world, in real time, behind the topics of a real one.

    Whatever drives the real robot can drive this one, such as [bold]kinfeas deploy[/] in another
    process. It ends after --seconds or with Ctrl-C.
    """
    options.check_robot(robot)
    from kinfeas.sim2real.simulator.playing import play, robot_link
    from kinfeas.sim2real.simulator.simulated_robot import Role, SimulatedRobot
    from kinfeas.sim2real.simulator.spawn import set_stage

    read = {"--robot": robot, "--task": task, "--scene": scene, "--topics": topics}
    check_outputs({"--json": json}, {option: inputs.named(name) for option, name in read.items()})
    if task is not None and scene is not None:
        raise KinfeasError("--task has a scene of its own: leave --scene out")
    role, who = Role(rate, command_timeout, seconds), options.read_robot(robot)
    link = robot_link(backend, who, topics)
    what = options.read_task(task, {}) if task is not None else None
    world, state = set_stage(who, what, scene, (seed, episode), gui=gui)
    player = SimulatedRobot(world, state, role)

    def ready() -> None:
        x, y = state.base_pose[0, :2]
        typer.echo(f"{who.name} stands at x {x:.2f} m, y {y:.2f} m and listens; Ctrl-C ends it")

    try:
        played = play(player, link, role, ready)
    finally:
        world.close()
    if json is not None:
        write_json(asdict(played), json)
    _show(played)


def _show(played: "Played") -> None:
    rows = [
        ("time", f"{played.seconds:.1f} s"),
        ("commands to the base", f"{played.base_commands}"),
        ("commands to the arm", f"{played.joint_commands}"),
        ("stops for want of commands", f"{played.timeouts}"),
        ("tick, 99 % below", f"{1000.0 * played.period_p99:.1f} ms"),
        ("longest tick", f"{1000.0 * played.longest:.1f} ms"),
    ]
    print_table("simulated robot", ("", " "), rows)
