"""Evaluation of a policy: metrics of its episodes in any world, beside the reachability bound."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from kinfeas.config import PluginSpec, from_mapping
from kinfeas.control.assemble import adapted_execution
from kinfeas.core.metrics import EpisodeRecords, Metrics, Proportion, summarize
from kinfeas.core.policy import Policy
from kinfeas.envs.episodes import OnDone, Watch, evaluate_episodes
from kinfeas.envs.world import World, WorldConfig, evaluation_section, evaluation_world
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.policies.loading import load_policy
from kinfeas.robots.loading import load_robot
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import StreamTask, Task


class Summary(Metrics):
    """Metrics of a policy and what they were measured on; the ceiling is null if not measured."""

    robot: str
    task: str
    policy: str
    seed: int
    world: str
    time_scale: float
    head_start: float
    adapters: list[str]
    filters: list[str]
    backend_parameters: dict[str, object]
    ceiling: float | None
    ceiling_low: float | None
    ceiling_high: float | None


@dataclass(frozen=True)
class EvalConfig:
    """An evaluation in episodes `first` to `first + episodes - 1` of a seed."""

    robot: Robot
    task: Task
    episodes: int = 500
    seed: int = 1
    world: WorldConfig = field(default_factory=evaluation_world)
    first: int = 0


@dataclass(frozen=True)
class EvalSettings:
    """Settings of an evaluation, from YAML or the command line.

    Attributes:
        task: Parameters of the task.
        world: Settings of the world.
    """

    task: dict[str, object] = field(default_factory=dict)
    world: WorldConfig = field(default_factory=evaluation_world)


def read_settings(robot: str, backend: str, overrides: Sequence[str] = ()) -> EvalSettings:
    """Return the settings in which the policies of a robot are evaluated.

    `overrides` are assignments such as `world.dt=0.05`.
    """
    return from_mapping(EvalSettings, *evaluation_section(backend, robot), overrides)


def prepare(  # noqa: PLR0913 - the options of the command
    policy: str,
    robot: str,
    task: str,
    backend: str = "analytic",
    *,
    episodes: int | None = None,
    seed: int = 1,
    overrides: Sequence[str] = (),
) -> tuple[EvalConfig, Policy]:
    """Return an evaluation and its policy by their names.

    The policy is a baseline, the folder of a run, an ONNX file or `pretrained`; `overrides` are
    assignments to `EvalSettings`.

    Raises:
        KinfeasError: If a name is unknown or a setting is wrong.
    """
    model = load_robot(robot)
    settings = read_settings(model.name, backend, overrides)
    count = default_episodes(backend) if episodes is None else episodes
    config = EvalConfig(model, load_task(task, settings.task), count, seed, settings.world)
    return config, load_policy(policy, model)


def default_episodes(backend: str) -> int:
    """Return the default number of episodes: 500, or 50 in worlds with physics."""
    return 500 if backend == "analytic" else 50


def adapter_subsets(adapters: Sequence[PluginSpec]) -> dict[str, tuple[PluginSpec, ...]]:
    """Return no adapters, each one alone, and all but each one, by label."""
    names, every = [one.name for one in adapters], tuple(adapters)
    return {
        "none": (),
        **{name: (one,) for name, one in zip(names, every, strict=True)},
        **{f"no {name}": every[:i] + every[i + 1 :] for i, name in enumerate(names)},
    }


def evaluate(  # noqa: PLR0913, PLR0917 - an evaluation and how to run it
    config: EvalConfig,
    policy: Policy,
    name: str = "",
    ceiling: Proportion | None = None,
    processes: int = 1,
    on_done: OnDone | None = None,
    watch: Watch | None = None,
) -> Summary:
    """Return the metrics of a policy: shares in 0-1, distances in metres.

    The ceiling is that of `reachability_of`; further arguments as in `evaluate_episodes`.
    """
    records = run(config, policy, processes, on_done, watch)
    world = config.world
    execution = adapted_execution(world, world.adapters, config.robot)
    return {
        "robot": config.robot.name,
        "task": config.task.name,
        "policy": name,
        "seed": config.seed,
        "world": world.backend,
        "time_scale": execution.time_scale,
        "head_start": execution.head_start,
        "adapters": [one.name for one in world.adapters],
        "filters": [one.name for one in world.filters],
        "backend_parameters": world.backend_parameters,
        **summarize(records),
        "ceiling": ceiling.value if ceiling else None,
        "ceiling_low": ceiling.low if ceiling else None,
        "ceiling_high": ceiling.high if ceiling else None,
    }


def run(
    config: EvalConfig,
    policy: Policy,
    processes: int = 1,
    on_done: OnDone | None = None,
    watch: Watch | None = None,
) -> EpisodeRecords:
    """Return the record of each episode; further arguments as in `evaluate_episodes`."""
    build = partial(World, config.robot, config.task, config.world, config.seed)
    episodes = range(config.first, config.first + config.episodes)
    return evaluate_episodes(build, policy, episodes, processes, on_done, watch)


def reachability_of(
    config: EvalConfig, on_done: Callable[[float], None] | None = None
) -> Proportion | None:
    """Return the share of an evaluation's goals that some base pose reaches; None for streams."""
    if isinstance(config.task, StreamTask):
        return None
    found = measure_reachability(
        config.robot, config.task, config.episodes, config.seed, config.world.ik, on_done
    )
    return found.share
