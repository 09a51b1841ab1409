"""Guarded and recorded runs on a real or simulated robot: to a goal, or along a plan."""

import re
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from math import inf
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from kinfeas.api import DEFAULT_ROBOT, Name
from kinfeas.api.load import (
    Adapters,
    checked,
    load_robot,
    plugin_settings,
    read_adapters,
    robot_of,
    text_of,
)
from kinfeas.api.plan import load_plan
from kinfeas.config import PluginSpec, Settings, from_mapping, merged, nested, strict_yaml
from kinfeas.config import load as load_config
from kinfeas.config.recipes import default_engine, section
from kinfeas.config.registry import from_anywhere
from kinfeas.control.assemble import build_backend, respond_late, with_adapters
from kinfeas.control.filters.path_planner import PlanFollower
from kinfeas.control.period import CommandFilter
from kinfeas.core.backend import closed_on_error
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_new, writing
from kinfeas.core.quantities import NotNegative, Quaternion, Rate, Seed, Vector
from kinfeas.core.spatial import distance
from kinfeas.core.start import episode_rng
from kinfeas.io.run_log import About, Moment, Recorder
from kinfeas.kinematics.ik import IkSolver
from kinfeas.planning.base_path import BasePath
from kinfeas.policies.loading import load_policy
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import furniture_solids, read_scene
from kinfeas.sim2real.deploy.config import DeployConfig, Guards
from kinfeas.sim2real.deploy.runtime import RunOutcome, Setup
from kinfeas.sim2real.deploy.runtime import deploy as run
from kinfeas.sim2real.deploy.start import GoalTask, make_goal_task, warm_up
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import MotionSpec, StagedTask, Task

T = TypeVar("T", bound=DeployConfig)
_CATCH_UP = 0.2  # lower bound of the speed limits with which the EE joins a plan, m/s and rad/s


@dataclass(frozen=True)
class Deployment:
    """A run that has ended."""

    outcome: RunOutcome  # its exit code, the reason of its end, and its statistics
    about: About  # header of its record
    record: Path  # CSV file of its record
    targets: dict[str, object]  # statistics of the targets that a servo has received


def deploy(  # noqa: PLR0913 - options of the command
    policy: Name | None = None,
    *,
    plan: Name | None = None,
    robot: Name | None = None,
    backend: str | None = None,
    goal: Sequence[float] | None = None,
    rpy: Sequence[float] | None = None,
    quaternion: Sequence[float] | None = None,
    generator: str | None = None,
    task: Name | None = None,
    rate: float = 50.0,
    seconds: float = 300.0,
    seed: int = 0,
    record: Name | None = None,
    adapters: Adapters | None = None,
    guards: Name | None = None,
    real_time: bool = True,
    filters: str | Sequence[str] | None = None,
    settings: Settings | None = None,
    on_moment: Callable[[Moment], None] | None = None,
) -> Deployment:
    """Run a policy on a robot and return the result; the base is stopped in any case.

    Example: `kinfeas.deploy("pretrained", backend="analytic", goal=(0.8, -0.2, 0.9)).outcome.code`

    Args:
        policy: Name, run folder, ONNX file, or `module:Class`.
        plan: File that `Plan.save` wrote, in place of policy, goal and task.
        robot: Name or folder; by default the robot of the policy.
        backend: `analytic`, `pybullet`, `mujoco`, `ros2`, `ros1`, or a plugin; by default PyBullet
            or, without it, MuJoCo.
        goal: World position of the EE, shape (3,), metres; none for a motion with
            `generator.frame=world`.
        rpy: Goal orientation as roll, pitch and yaw, radians; that of the start by default.
        quaternion: Goal orientation as a quaternion xyzw, in place of `rpy`.
        generator: Motion generator; `linear` by default, with a scene `whole_body`.
        task: Name or YAML file, in place of the goal.
        rate: Control rate, Hz.
        seconds: Maximum duration, seconds.
        seed: Random seed.
        record: New CSV file; by default one in `runs/deploy`.
        adapters: Name or YAML file of a list of adapters, or its entries.
        guards: YAML file with the limits of the guards.
        real_time: Whether a simulation is slowed down to real time.
        filters: Names of command filters; the robot's by default.
        settings: Values by key of `DeployConfig`, such as `scene` or `guards.max_tilt`.
        on_moment: Called with each line of the record.

    Returns:
        A `Deployment`, whose `outcome.code` is 0 if the goal was reached, 3 if a guard or an error
        stopped the run, 4 if its time was over or the task is not done, 128 + N after signal N.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the run cannot start.
    """
    if policy is None and plan is None:
        raise KinfeasError("give a policy or a 'plan'")
    plan_robot, robot = robot, robot or robot_of(policy)
    model = load_robot(robot)
    late = respond_late(read_adapters(adapters)) or not model.response.immediate
    arguments = DeployConfig, "deploy", model, guards, filters, settings
    config = read_config(*arguments, late=late)
    if config.late and not late:
        config = read_config(*arguments, late=True)
    follower: tuple[CommandFilter, ...] = ()
    if plan is not None:
        excluded = (policy, goal, rpy, quaternion, generator, task)
        if any(each is not None for each in excluded) or config.generator or config.task:
            raise KinfeasError("'plan' excludes a policy, a goal, 'generator' and 'task'")
        policy, dt = "stationary", 1.0 / checked(Rate, rate, "rate")
        motion_task, follower = _plan_task(plan, plan_robot, dt)
        # The path planner would plan another path.
        kept = tuple(spec for spec in config.filters if spec.name != "path_planner")
        config = replace(config, filters=kept)
    elif task is None:
        motion_task = _goal_task(goal, rpy, quaternion, generator, config)
    elif any(each is not None for each in (goal, rpy, quaternion)) or generator or config.generator:
        raise KinfeasError("'task' excludes 'goal', 'rpy', 'quaternion' and 'generator'")
    elif config.scene is not None:
        raise KinfeasError("'task' has its own 'scene'")
    else:
        motion_task = load_task(str(task), config.task)
    backend = backend or default_engine()
    setup = make_setup(
        policy or "", model, backend, motion_task, config, record, adapters=read_adapters(adapters),
        rate=rate, seconds=seconds, seed=checked(Seed, seed, "seed"), real_time=real_time,
        leading=follower,
    )  # fmt: skip
    return recorded(setup, text_of(robot, "robot"), str(policy), backend, record, on_moment)


def recorded(  # noqa: PLR0913 - the parts of a recorded run
    setup: Setup,
    robot: str,
    policy: str,
    backend: str,
    record: Name | None,
    on_moment: Callable[[Moment], None] | None = None,
    *,
    adapters: tuple[PluginSpec, ...] = (),
) -> Deployment:
    """Run and record a setup; the header also lists `adapters`, which are inside its backend."""
    with closed_on_error(setup.backend):
        about = _about(setup, robot, policy, backend, adapters)
        path = _new_record(about) if record is None else Path(record)
        with Recorder(path, about, on_moment) as recorder:
            outcome = run(setup, recorder)
    return Deployment(outcome, about, path, {})


def _about(
    setup: Setup, robot: str, policy: str, backend: str, adapters: tuple[PluginSpec, ...]
) -> About:
    joints = tuple(joint.name for joint in setup.solver.robot.arm)
    now = datetime.now().astimezone().isoformat(timespec="seconds")
    motions = [subgoal.motion for subgoal in setup.task.subgoals]
    return About(
        from_anywhere(robot), setup.task.name, policy, backend, setup.dt, joints, now,
        seed=setup.seed, adapters=(*adapters, *setup.adapters),
        filters=setup.config.filters,
        generators=tuple(PluginSpec(motion.generator, motion.parameters) for motion in motions),
        guards={k: None if v == inf else v for k, v in asdict(setup.guards).items()},
        arm_seconds=setup.backend.arm_seconds,
        **_drawn_scene(setup),
    )  # fmt: skip


def read_config(  # noqa: PLR0913 - where settings come from
    cls: type[T],
    name: str,
    robot: Robot,
    guards: Name | None,
    filters: str | Sequence[str] | None,
    settings: Settings | None,
    *,
    late: bool = False,
) -> T:
    """Return a robot's settings of the section `name`, with the guards of the user's file.

    With `late`, for a robot that responds late, the filters are those of its section `sim2real`.
    """
    data, source = section(name, robot.folder)
    if late:
        data = {**data, "filters": section("sim2real", robot.folder)[0]["world"]["filters"]}
    if guards is not None:
        file = Path(text_of(guards, "guards"))
        load_config(Guards, file)  # so that errors name this file
        data = merged(data, {"guards": strict_yaml.read(file)})
    return from_mapping(cls, data, source, nested(plugin_settings(filters), settings))


def _goal_task(
    goal: Sequence[float] | None,
    rpy: Sequence[float] | None,
    quaternion: Sequence[float] | None,
    generator: str | None,
    config: DeployConfig,
) -> Task:
    own = config.generator.get("frame") == "world"  # the motion has a goal of its own
    if (goal is None and not own) or config.task:
        raise KinfeasError("give a goal, or a task; task.KEY are settings of the latter")
    goal = (0.0, 0.0, 0.0) if goal is None else goal
    if rpy is not None and quaternion is not None:
        raise KinfeasError("'rpy' and 'quaternion' exclude each other")
    if generator is None:
        generator = "linear" if config.scene is None else "whole_body"
    motion = MotionSpec(text_of(generator, "generator"), config.generator)
    position = _listed(Vector, goal, "goal")
    if quaternion is not None:
        return make_goal_task(position, _listed(Quaternion, quaternion, "quaternion"), motion)
    orientation = None if rpy is None else _listed(Vector, rpy, "rpy")
    return make_goal_task(position, orientation, motion)


def _listed(kind: Any, numbers: object, name: str) -> Sequence[float]:
    """Return numbers, such as an array, as a list of the type `kind`; or raise KinfeasError."""
    numbers = np.asarray(numbers, dtype=object).tolist()
    return cast("Sequence[float]", checked(kind, numbers, name))


def _plan_task(file: Name, robot: Name | None, dt: float) -> tuple[Task, tuple[CommandFilter, ...]]:
    """Return the EE motion of a plan as a task from its start, and a filter that follows it."""
    if not isinstance(file, str | Path):
        raise KinfeasError(f"'plan' must be a file, as of Plan.save, not {reprlib.repr(file)}")
    try:
        plan = load_plan(file, robot or DEFAULT_ROBOT)
    except KinfeasError as error:
        if robot is not None or not Path(file).is_file():
            raise
        hint = f"give the plan's 'robot', {DEFAULT_ROBOT} by default"
        raise KinfeasError(f"{error}; {hint}") from error
    parameters: Settings = {"file": str(file), "frame": "world", "waits": False}
    seconds = np.diff(plan.time)
    steps = distance(plan.ee_pose[:-1], plan.ee_pose[1:])
    limits = [max(2.0 * float((step / seconds).max()), _CATCH_UP) for step in steps]
    names = ("max_velocity", "max_angular_velocity")
    motion = MotionSpec("replay", {**parameters, **dict(zip(names, limits, strict=True))})
    goal, start = plan.ee_pose[-1], (plan.base_pose[0], plan.joint_positions[0])
    states, ones = np.hstack([plan.base, plan.joint_positions]), np.ones(len(plan.time))
    path = BasePath(plan.ee_pose, float(seconds.mean()), 0.0, plan.time, states, ones)
    follower = PlanFollower(plan.robot, dt, path)
    return GoalTask(goal[:3], goal[3:], motion, "plan", start), (follower,)


def make_setup(  # noqa: PLR0913 - the parts of a run
    policy_name: Name,
    robot: Robot,
    backend_name: str,
    task: Task,
    config: DeployConfig,
    record: Name | None,
    *,
    rate: float,
    seconds: float,
    adapters: tuple[PluginSpec, ...] = (),
    inner: tuple[PluginSpec, ...] = (),
    leading: tuple[CommandFilter, ...] = (),
    seed: int = 0,
    real_time: bool = True,
) -> Setup:
    """Return the parts of a run: kernels are compiled, and the backend is connected.

    `inner` adapters simulate the robot itself: guards and the other adapters are around them.
    """
    check_new(None if record is None else text_of(record, "record"))
    dt = 1.0 / checked(Rate, rate, "rate")
    if seconds != inf:
        seconds = checked(NotNegative, seconds, "seconds")
    policy = load_policy(text_of(policy_name, "policy"), robot)
    solver = IkSolver(robot, config.ik)
    solids = furniture_solids(read_scene(config.scene)) if config.scene else None
    warm_up(solver, policy, task, dt, adapters, config.filters)
    backend = build_backend(backend_name, config.backend, robot=robot)
    with closed_on_error(backend):
        if backend.real_time is not None:
            if inner or adapters:
                raise KinfeasError(
                    f"adapters rehearse in simulated worlds; {backend_name!r} is a robot, "
                    "whose lag goes into the section 'response' of its robot.yaml"
                )
            if not real_time:
                raise KinfeasError(f"backend {backend_name!r} is always in real time")
        if backend.staging is not None:
            task = backend.staging.stage(task)
        return Setup(
            solver=solver, policy=policy, task=task, config=config, adapters=adapters, dt=dt,
            backend=with_adapters(backend, inner, robot), solids=solids, seconds=seconds,
            leading=leading, seed=seed, real_time=real_time,
        )  # fmt: skip


def _drawn_scene(setup: Setup) -> dict[str, Any]:
    """Return scene, objects and solids for the record, drawn as the run draws them later."""
    task = setup.task
    drawn: dict[str, Any] = {}
    if setup.solids is not None:
        return {"solids": tuple(map(tuple, setup.solids.table.tolist()))}
    if setup.backend.solids is None:  # a robot
        return drawn
    start = task.sample(setup.solver, episode_rng(setup.seed, 0))
    solids = start.solids
    if isinstance(task, StagedTask):
        scene, poses, solids = task.drawn(start)
        objects = {name: tuple(pose.tolist()) for name, pose in poses.items()}
        drawn |= {"scene": from_anywhere(scene), "objects": objects}
    if solids is not None:
        drawn["solids"] = tuple(map(tuple, solids.table.tolist()))
    return drawn


def _new_record(about: About) -> Path:
    folder = Path("runs/deploy")
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    robot, task = (re.sub(r"[^\w-]", "_", name) for name in (Path(about.robot).stem, about.task))
    return folder / f"{datetime.now():%Y%m%d-%H%M%S-%f}-{robot}-{task}.csv"
