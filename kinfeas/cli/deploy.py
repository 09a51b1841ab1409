"""`kinfeas deploy`, `servo` and `simulate`: run a policy on a robot, and simulate one."""

import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from kinfeas.api import DEFAULT_ROBOT
from kinfeas.cli import options
from kinfeas.cli.options import option
from kinfeas.cli.output import print_facts, run_status, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.quantities import Quaternion, Vector

if TYPE_CHECKING:
    from kinfeas.api.deploy import Deployment


def deploy(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.OptionalPolicy = None,
    robot: options.PolicyRobotName = None,
    plan: Path | None = option(
        None, "In place of policy and goal: a file of kinfeas plan.", metavar="FILE.csv"
    ),
    backend: options.RobotBackend = None,
    goal: Vector | None = option(None, "EE goal in the world frame, metres.", metavar="X Y Z"),
    rpy: Vector | None = option(None, "Orientation, rad.  [default: unchanged]", metavar="R P Y"),
    quaternion: Quaternion | None = option(
        None, "Goal orientation as a quaternion.", metavar="X Y Z W"
    ),
    generator: str | None = option(
        None, "Motion generator.  [default: linear; with a scene whole_body]"
    ),
    task: str | None = option(None, f"In place of --goal. {options.TASK}"),
    rate: options.Rate = 50.0,
    seconds: float = option(300.0, "Maximum duration.", min=0.0),
    seed: options.Seed = 0,
    record: options.Record = None,
    adapters: options.AdapterList = None,
    guards: options.GuardsFile = None,
    no_real_time: bool = option(False, "Simulate as fast as possible.", "--no-real-time"),
    filters: options.Filters = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Run a policy or a plan on a robot, behind guards.

    Settings: guards.KEY, time_scale, head_start, arm_settle_timeout, ik.KEY, generator.KEY,
    task.KEY, backend.KEY, scene; see docs/deploy.md. The run is recorded as CSV.

    Exit codes: 0 goal reached, 2 bad input, 3 stopped by a guard or an error, 4 --seconds exceeded
    or task not done, 128 + N signal N. The base is always stopped.

    Example: kinfeas deploy pr2.onnx --backend ros2 --goal 0.8 -0.2 0.9
    """
    from kinfeas.api import deploy as api

    with run_status() as on_moment:
        done = api.deploy(
            policy, plan=plan, robot=robot, backend=backend, goal=goal, rpy=rpy,
            quaternion=quaternion, generator=generator, task=task, rate=rate, seconds=seconds,
            seed=seed, record=record, adapters=adapters, guards=guards,
            real_time=not no_real_time, filters=filters, settings=options.read_settings(overrides),
            on_moment=on_moment,
        )  # fmt: skip
    raise typer.Exit(report(done, json))


def servo(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument = "pretrained",
    robot: options.PolicyRobotName = None,
    backend: options.RobotBackend = None,
    source: str = option("ros2", "ros2, ros1, module:Class, plugin."),
    rate: options.Rate = 50.0,
    seconds: float = option(3600.0, "Duration of the run.", min=0.0),
    record: options.Record = None,
    adapters: options.AdapterList = None,
    guards: options.GuardsFile = None,
    filters: options.Filters = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Follow EE poses or twists that arrive during the run.

    Settings: rules.KEY (limits of targets), source.KEY, generator.KEY, guards.KEY, ik.KEY,
    backend.KEY; see docs/teleoperation.md.

    Exit codes: 0 --seconds are over, others as of deploy.

    Example: kinfeas servo pretrained --robot pr2 --backend ros2 --source ros2
    """
    from kinfeas.api import servo as api

    with run_status(goal=False) as on_moment:
        done = api.servo(
            policy, robot=robot, backend=backend, source=source, rate=rate, seconds=seconds,
            record=record, adapters=adapters, guards=guards, filters=filters,
            settings=options.read_settings(overrides), on_moment=on_moment,
        )  # fmt: skip
    raise typer.Exit(report(done, json))


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
    from kinfeas.sim2real import simulator
    from kinfeas.sim2real.deploy.runtime import Signals
    from kinfeas.tasks.loading import load_task

    if task is not None and scene is not None:
        raise KinfeasError("--task has its own scene and excludes --scene")
    model = load_robot(robot)
    link = simulator.robot_link(backend, model, topics)
    drawn_by = load_task(task) if task is not None else None
    rng = episode_rng(seed, episode)
    with Signals():  # also SIGINT, which background jobs of scripts ignore by default
        room, state = simulator.spawn(
            model, drawn_by, scene, rng=rng, engine=world, gui=gui, adapters=read_adapters(adapters)
        )
        player = simulator.SimulatedRobot(room, state, command_timeout)

        def ready() -> None:
            x, y = state.base_pose[0, :2]
            typer.echo(f"{model.name} is ready at x {x:.2f} m, y {y:.2f} m; Ctrl-C ends it")

        try:
            duration = float("inf") if seconds is None else seconds
            played = simulator.simulate(player, link, ready, rate, duration)
        finally:
            room.close()
    write_json(asdict(played), json)
    print_facts("simulated robot", asdict(played))


def report(done: "Deployment", json: Path | None) -> int:
    """Print the results of a run and return its exit code."""
    outcome, about = done.outcome, done.about
    code = int(outcome.code)
    facts = {**asdict(outcome), "code": code, **done.targets, "record": str(done.record)}
    title = f"{about.policy} on {about.task}, robot {about.robot}, {about.backend}"
    with suppress(OSError):  # the terminal may have been closed
        print_facts(title, {key: fact for key, fact in facts.items() if fact or fact == 0})
        if code:
            sys.stderr.write(f"stopped: {outcome.reason}\n")
        if outcome.unstopped:
            sys.stderr.write(f"the base could not be commanded to zero: {outcome.unstopped}\n")
        if outcome.unclosed:
            sys.stderr.write(f"could not be closed: {outcome.unclosed}\n")
    try:
        write_json(facts, json)
    except KinfeasError as error:  # keeps the exit code of the run
        sys.stderr.write(f"--json: {error}\n")
    return code
