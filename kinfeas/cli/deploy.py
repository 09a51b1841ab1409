"""`kinfeas deploy`: run a policy on a robot or a simulated one."""

import re
import sys
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from kinfeas.cli import options
from kinfeas.cli.output import print_facts, status, write_json
from kinfeas.core.errors import KinfeasError
from kinfeas.core.registry import from_anywhere

if TYPE_CHECKING:
    from collections.abc import Callable

    from kinfeas.config import PluginSpec
    from kinfeas.io.run_log import About
    from kinfeas.robots.robot import Robot
    from kinfeas.sim2real.deploy.config import DeployConfig
    from kinfeas.sim2real.deploy.runtime import Outcome, Setup
    from kinfeas.tasks.task import Task

T = TypeVar("T")
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


def deploy(  # noqa: PLR0913, PLR0917 - each option is an argument
    policy: options.PolicyArgument,
    robot: options.PolicyRobotName = None,
    backend: options.RobotBackend = None,
    goal: Annotated[
        Three | None,
        typer.Option(metavar="X Y Z", help="Goal of the EE in the world frame, metres."),
    ] = None,
    rpy: Annotated[
        Three | None,
        typer.Option(
            metavar="R P Y",
            help="Goal orientation, rad.  [default: the present one]",
        ),
    ] = None,
    quaternion: Annotated[
        Four | None, typer.Option(metavar="X Y Z W", help="Goal orientation as a quaternion.")
    ] = None,
    generator: Annotated[
        str | None,
        typer.Option(
            help="Motion generator to the goal.  [default: linear; with a scene whole_body]",
            autocompletion=options.names_of("motion_generators"),
        ),
    ] = None,
    task: Annotated[str | None, options.task_option("In place of --goal. ")] = None,
    rate: options.Rate = 50.0,
    seconds: Annotated[float, typer.Option(min=0.0, help="Maximum duration.")] = 300.0,
    seed: options.Seed = 0,
    record: options.Record = None,
    adapters: options.AdapterList = None,
    guards: options.GuardsFile = None,
    no_real_time: Annotated[
        bool, typer.Option("--no-real-time", help="Simulate as fast as possible.")
    ] = False,
    filters: options.Filters = None,
    overrides: options.Overrides = None,
    json: options.JsonPath = None,
) -> None:
    """Run a policy on a robot, behind guards, and record the run as CSV.

    Settings: guards.KEY, time_scale, head_start, arm_settle_timeout, ik.KEY, generator.KEY,
    task.KEY, backend.KEY, scene; see docs/deploy.md.

    Exit codes: 0 goal reached, 2 bad input, 3 stopped by a guard or an error, 4 --seconds exceeded,
    128 + N signal N. The base is always stopped.

    Example: kinfeas deploy pr2.onnx --backend ros2 --goal 0.8 -0.2 0.9
    """
    from kinfeas.config.recipes import default_engine
    from kinfeas.sim2real.deploy.config import DeployConfig

    check_record(record)
    with status("preparing"):
        robot, backend = robot or options.robot_of(policy), backend or default_engine()
        known = options.read_robot(robot)
        changes = options.with_filters(filters, overrides or [], "")
        config = read_settings(DeployConfig, "deploy", known, guards, changes)
        if task is None:
            toward = _goal_task(goal, rpy, quaternion, generator, config)
        elif goal or rpy or quaternion or generator or config.generator:
            raise KinfeasError("--task excludes --goal, --rpy, --quaternion and --generator")
        elif config.scene is not None:
            raise KinfeasError("scene: --task has its own")
        else:
            toward = options.read_task(task, config.task)
        setup = make_setup(
            policy, backend, known, toward, config, adapters=options.read_adapters(adapters),
            dt=1.0 / rate, seconds=seconds, seed=seed, real_time=not no_real_time,
        )  # fmt: skip
    raise typer.Exit(run_and_report(setup, robot, policy, backend, record, json))


def run_and_report(  # noqa: PLR0913, PLR0917 - see deploy
    setup: "Setup",
    robot: str,
    policy: str,
    backend: str,
    record: Path | None,
    json: Path | None,
    more: "Callable[[], dict[str, object]]" = dict,
) -> int:
    """Run, write the record and results, with `more` of them; return the code of the run."""
    from kinfeas.io.run_log import About, Recorder
    from kinfeas.sim2real.deploy.runtime import deploy as run

    joints = tuple(joint.name for joint in setup.solver.robot.arm)
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    about = About(
        from_anywhere(robot), setup.task.name, policy, backend, setup.dt, joints, now,
        **_drawn_scene(setup), **_settings(setup),
    )  # fmt: skip
    recorder = Recorder(record or _record_path(about), about)
    with recorder:
        outcome = run(setup, recorder)
    facts = {**asdict(outcome), "code": int(outcome.code), **more(), "record": str(recorder.path)}
    with suppress(OSError):  # of a terminal that was closed
        _show(outcome, about, facts)
    try:
        write_json(facts, json)
    except KinfeasError as error:  # keeps the exit code of the run
        sys.stderr.write(f"--json: {error}\n")
    return int(outcome.code)


def check_record(record: Path | None) -> None:
    """Raise KinfeasError if `record` is no new CSV file."""
    if record is not None and (record.exists() or record.suffix != ".csv"):
        raise KinfeasError(f"--record: {record} must be a new file that ends in .csv")


def read_settings(
    cls: type[T], name: str, robot: "Robot", guards: Path | None, overrides: list[str]
) -> T:
    """Return the settings of a section for a robot, with the guards of the user's file."""
    from kinfeas import config
    from kinfeas.config import strict_yaml
    from kinfeas.config.recipes import section
    from kinfeas.sim2real.deploy.config import Guards

    data, source = section(name, robot.name)
    if guards is not None:
        config.load(Guards, guards)  # so that errors name this file
        data["guards"] = {**data.get("guards", {}), **strict_yaml.read(guards)}
    return config.from_mapping(cls, data, source, overrides)


def _goal_task(
    goal: Three | None,
    rpy: Three | None,
    quaternion: Four | None,
    generator: str | None,
    config: "DeployConfig",
) -> "Task":
    from kinfeas.sim2real.deploy.goal_task import make_goal_task
    from kinfeas.tasks.task import MotionSpec

    if goal is None or config.task:
        raise KinfeasError("give --goal X Y Z, or --task NAME, with --set task.KEY for the latter")
    if rpy is not None and quaternion is not None:
        raise KinfeasError("--rpy and --quaternion exclude each other")
    usual = "linear" if config.scene is None else "whole_body"
    motion = MotionSpec(generator or usual, config.generator)
    return make_goal_task(goal, quaternion or rpy, motion)


def make_setup(  # noqa: PLR0913 - the parts of a run
    policy_name: str,
    backend_name: str,
    robot: "Robot",
    task: "Task",
    config: "DeployConfig",
    *,
    adapters: "tuple[PluginSpec, ...]",
    dt: float,
    real_time: bool,
    **limits: Any,
) -> "Setup":
    """Return the parts of the run, after each has computed something."""
    from kinfeas.core.backend import build_backend
    from kinfeas.kinematics.ik import IkSolver
    from kinfeas.policies.loading import load_policy
    from kinfeas.scenes.scene import read_scene
    from kinfeas.scenes.solids import furniture_solids
    from kinfeas.sim2real.deploy.preflight import warm_up
    from kinfeas.sim2real.deploy.runtime import Setup

    policy, solver = load_policy(policy_name, robot), IkSolver(robot, config.ik)
    solids = furniture_solids(read_scene(config.scene)) if config.scene else None
    warm_up(solver, policy, task, dt, adapters, config.filters)
    backend = build_backend(backend_name, config.backend, robot=robot)
    if backend.staging is not None:
        task = backend.staging.stage(task)
    return Setup(
        solver=solver, policy=policy, task=task, backend=backend, execution=config,
        filters=config.filters, guards=config.guards, adapters=adapters, dt=dt,
        real_time=real_time, solids=solids, **limits,
    )  # fmt: skip


def _drawn_scene(setup: "Setup") -> dict[str, Any]:
    """Return scene, objects and solids of the record; the episode is drawn in advance."""
    from kinfeas.backends.physics.backend import PhysicsBackend
    from kinfeas.core.start import episode_rng
    from kinfeas.sim2real.deploy.runtime import TaskWithObjects

    task = setup.task
    drawn: dict[str, Any] = {}
    if setup.solids is not None:
        return {"solids": tuple(map(tuple, setup.solids.table.tolist()))}
    if setup.backend.solids is None:  # a robot
        return drawn
    start = task.sample(setup.solver, episode_rng(setup.seed, 0))
    if start.solids is not None:
        solids = start.solids
        if isinstance(setup.backend, PhysicsBackend):  # furniture is drawn as a scene
            solids = solids.beyond(setup.backend.furniture)
        drawn["solids"] = tuple(map(tuple, solids.table.tolist()))
    if isinstance(task, TaskWithObjects):
        scene, poses = task.drawn()
        objects = {name: tuple(pose.tolist()) for name, pose in poses.items()}
        drawn |= {"scene": from_anywhere(scene), "objects": objects}
    return drawn


def _settings(setup: "Setup") -> dict[str, Any]:
    """Return adapters, filters, generators, guards and seed of the record."""
    from kinfeas.config import PluginSpec

    motions = [subgoal.motion for subgoal in setup.task.subgoals]
    return {
        "seed": setup.seed,
        "adapters": setup.adapters,
        "filters": getattr(setup.execution, "filters", ()),
        "generators": tuple(PluginSpec(one.generator, one.parameters) for one in motions),
        "guards": {k: None if v == inf else v for k, v in asdict(setup.guards).items()},
    }


def _record_path(about: "About") -> Path:
    """Return a new file in `runs/deploy`."""
    from kinfeas.io.files import writing

    folder = Path("runs/deploy")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    date = datetime.fromisoformat(about.started).strftime("%Y%m%d-%H%M%S")
    robot, task = (re.sub(r"[^\w-]", "_", one) for one in (Path(about.robot).stem, about.task))
    name = f"{date}-{robot}-{task}"
    names = (name, *(f"{name}-{number}" for number in range(2, 100)))  # of the same second
    paths = [folder / f"{one}.csv" for one in names]
    return next((path for path in paths if not path.exists()), paths[0])


def _show(outcome: "Outcome", about: "About", facts: dict[str, object]) -> None:
    from kinfeas.sim2real.link.rate import peak_memory_mb

    title = f"{about.policy} on {about.task}, robot {about.robot}, {about.backend}"
    print_facts(title, {**facts, "peak_memory_mb": peak_memory_mb()})
    if outcome.code:
        sys.stderr.write(f"stopped: {outcome.reason}\n")
    if outcome.unstopped:
        sys.stderr.write(f"the base could not be commanded to zero: {outcome.unstopped}\n")
    if outcome.unclosed:
        sys.stderr.write(f"the backend could not be closed: {outcome.unclosed}\n")
