"""What `kinfeas deploy` is told, made into a run."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from kinfeas.cli import options
from kinfeas.core.errors import KinfeasError

if TYPE_CHECKING:
    from kinfeas.robots.robot import Robot
    from kinfeas.sim2real.deploy.config import DeployConfig
    from kinfeas.sim2real.deploy.deployment import Setup
    from kinfeas.tasks.task import Task

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


class Wishes(NamedTuple):
    """What was said of the run."""

    policy: str
    robot: str
    backend: str
    sim2real: str | None
    dt: float
    seconds: float
    seed: int
    real_time: bool


class Goal(NamedTuple):
    """What was said of where the EE shall go."""

    task: str | None
    generator: str | None
    goal: Three | None
    rpy: Three | None
    quaternion: Four | None


def read_settings(robot: "Robot", guards: Path | None, overrides: list[str]) -> "DeployConfig":
    """Return the settings for a robot, with the user's guards."""
    from kinfeas import config
    from kinfeas.config import strict_yaml
    from kinfeas.config.recipes import section
    from kinfeas.sim2real.deploy.config import DeployConfig
    from kinfeas.sim2real.deploy.guard_config import Guards

    data, source = section("deploy", robot.name)
    if guards is not None:
        config.load(Guards, guards)  # so that errors name this file
        recipe = config.from_mapping(DeployConfig, data, source)
        data["guards"] = config.to_mapping(recipe.guards) | strict_yaml.read(guards)
    return config.from_mapping(DeployConfig, data, source, overrides)


def make_task(wanted: Goal, config: "DeployConfig") -> "Task":
    """Return the task that was named, or that of a single goal."""
    from kinfeas.sim2real.deploy.goal_task import make_goal_task
    from kinfeas.tasks.task import MotionSpec

    if wanted.task is not None:
        for name in ("goal", "rpy", "quaternion", "generator"):
            if getattr(wanted, name) is not None:
                raise KinfeasError(f"--{name} and --task exclude each other")
        if config.generator:
            raise KinfeasError("--set generator.KEY and --task exclude each other")
        return options.read_task(wanted.task, config.task)
    if wanted.goal is None:
        raise KinfeasError("say where to go: --goal X Y Z, or --task NAME or FILE")
    if config.task:
        raise KinfeasError("--set task.KEY needs --task")
    if wanted.rpy is not None and wanted.quaternion is not None:
        raise KinfeasError("--rpy and --quaternion exclude each other")
    return make_goal_task(
        wanted.goal,
        wanted.quaternion or wanted.rpy,
        MotionSpec(wanted.generator or "linear", config.generator),
    )


def make_setup(wishes: Wishes, robot: "Robot", config: "DeployConfig", task: "Task") -> "Setup":
    """Return what the run is made of, once each part has computed something."""
    from kinfeas.control.adapters import read_sim2real
    from kinfeas.control.filters import build_filters
    from kinfeas.control.filters.rollout import RolloutPlanner
    from kinfeas.core.backend import RealTimeBackend, build_backend
    from kinfeas.kinematics.ik import IkSolver
    from kinfeas.policies.loading import load_policy
    from kinfeas.sim2real.deploy.deployment import Setup
    from kinfeas.sim2real.deploy.rollout_planner_thread import RolloutPlannerThread
    from kinfeas.sim2real.deploy.warm_up import warm_up
    from kinfeas.tasks.task import SupportsTaskScenes

    adapters = read_sim2real(wishes.sim2real).adapters if wishes.sim2real is not None else ()
    policy, solver = load_policy(wishes.policy, robot), IkSolver(robot, config.ik)
    filters = build_filters(config.filters)
    warm_up(solver, policy, task, wishes.dt, adapters, filters)
    backend = build_backend(wishes.backend, config.backend, robot=robot)
    if isinstance(backend, SupportsTaskScenes):
        task = backend.stage(task)
    # A world without a clock waits for a look, and so comes out the same each time.
    if wishes.real_time or isinstance(backend, RealTimeBackend):
        filters = [
            RolloutPlannerThread.of(one) if isinstance(one, RolloutPlanner) else one
            for one in build_filters(config.filters)
        ]
    return Setup(
        solver=solver,
        policy=policy,
        task=task,
        backend=backend,
        dt=wishes.dt,
        adapters=adapters,
        seconds=wishes.seconds,
        seed=wishes.seed,
        execution=config.execution,
        filters=tuple(filters),
        guards=config.guards,
        real_time=wishes.real_time,
    )


def drawn_scene(setup: "Setup") -> dict[str, Any]:
    """Return what a record says of the furniture: the run's episode is drawn beforehand."""
    import numpy as np

    from kinfeas.core.registry import from_anywhere
    from kinfeas.sim2real.deploy.deployment import TaskWithObjects

    if not isinstance(setup.task, TaskWithObjects):
        return {}
    setup.task.sample(setup.solver, np.random.default_rng((setup.seed, 0)))
    scene, poses = setup.task.drawn()
    objects = {name: tuple(pose.tolist()) for name, pose in poses.items()}
    return {"scene": from_anywhere(scene), "objects": objects}
