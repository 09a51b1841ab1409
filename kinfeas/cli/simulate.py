"""`kinfeas simulate`: a simulated robot behind the topics of a real one."""

from dataclasses import asdict

import typer

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_facts, write_json
from kinfeas.core.errors import KinfeasError


def simulate(  # noqa: PLR0913, PLR0917 - each option is an argument
    backend: str = option("ros2", "Bus: ros2, ros1, or a plugin with topics."),
    robot: options.RobotName = DEFAULT_ROBOT,
    task: str | None = option(None, "Begin as in an episode of this task."),
    episode: int = option(0, "Number of the episode.", min=0),
    seed: options.Seed = 0,
    scene: str | None = option(None, "Scene by name or YAML file.  [default: that of --task]"),
    adapters: options.AdapterList = None,
    topics: str | None = option(None, "YAML of the topics.  [default: those of the robot]"),
    rate: float = option(100.0, "Measurement rate, Hz.", min=10.0, max=1000.0),
    seconds: float | None = option(None, "Duration.  [default: unlimited]", min=0.0),
    command_timeout: float = option(0.25, "The base stops after these seconds.", min=0.0),
    world: str | None = option(None, "pybullet or mujoco.  [default: the installed one]"),
    gui: bool = option(False, "PyBullet: show a window.", "--gui"),
    json: options.JsonPath = None,
) -> None:
    """Simulate a robot behind ROS topics, with physics in real time.

    Programs for the real robot, such as kinfeas deploy, can drive it. Ctrl-C or SIGTERM ends it,
    with code 0. Adapters lie around the robot: what drives it meets their noise, latency and
    limits.

    Example: kinfeas simulate --backend ros2 --robot pr2 --task door
    """
    from kinfeas.api.load import read_adapters
    from kinfeas.core.start import episode_rng
    from kinfeas.robots.loading import load_robot
    from kinfeas.sim2real.deploy.runtime import Signals
    from kinfeas.sim2real.simulator import simulation
    from kinfeas.tasks.loading import load_task

    if task is not None and scene is not None:
        raise KinfeasError("--task has its own scene and excludes --scene")
    model = load_robot(robot)
    link = simulation.robot_link(backend, model, topics)
    drawn_by = load_task(task) if task is not None else None
    rng = episode_rng(seed, episode)
    with Signals():  # SIGINT also in the background of a script, where it is ignored
        room, state = simulation.spawn(
            model, drawn_by, scene, rng=rng, engine=world, gui=gui, adapters=read_adapters(adapters)
        )
        player = simulation.SimulatedRobot(room, state, command_timeout)

        def ready() -> None:
            x, y = state.base_pose[0, :2]
            typer.echo(f"{model.name} is ready at x {x:.2f} m, y {y:.2f} m; Ctrl-C ends it")

        try:
            duration = float("inf") if seconds is None else seconds
            played = simulation.simulate(player, link, ready, rate, duration)
        finally:
            room.close()
    write_json(asdict(played), json)
    print_facts("simulated robot", asdict(played))
