"""Evaluation of a policy: metrics of its episodes in any world, and their reachability bound."""

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from kinfeas import __version__
from kinfeas.config import PluginSpec, Settings, from_mapping, merged, nested, to_mapping
from kinfeas.config.recipes import section
from kinfeas.control.execution import ExecutionConfig
from kinfeas.core.metrics import EpisodeRecords, Metrics, summarize
from kinfeas.core.policy import Policy
from kinfeas.envs.episodes import OnDone, Watch, closed, evaluate_episodes, run_episodes
from kinfeas.envs.world import World, WorldConfig, evaluation_section, evaluation_world
from kinfeas.evaluation.reachability import measure_reachability
from kinfeas.robots.robot import Robot
from kinfeas.tasks.loading import load_task
from kinfeas.tasks.task import StreamTask, Task


class Summary(Metrics):
    """Metrics of a policy, what they were measured on, and the ceiling; null if not measured.

    `settings` are the changes to the defaults. `failed` are the numbers of the episodes without
    success, or with a task that was not done, by reason; `per_episode` has a column for each field
    of the records.
    """

    robot: str
    task: str
    policy: str
    seed: int
    world: str
    dt: float
    time_scale: float
    head_start: float
    adapters: list[str]
    filters: list[str]
    backend_parameters: dict[str, object]
    settings: dict[str, object]
    version: str
    failed: dict[str, list[int]]
    per_episode: dict[str, list[float | None]]
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
    settings: Settings = field(default_factory=dict)  # changes of defaults in `task` and `world`


@dataclass(frozen=True)
class EvalSettings:
    """Settings of an evaluation, from YAML or the command line."""

    task: dict[str, object] = field(default_factory=dict)  # parameters of the task
    world: WorldConfig = field(default_factory=evaluation_world)  # settings of the world


def read_settings(
    robot: str | Path, backend: str, settings: Settings | None = None
) -> EvalSettings:
    """Return the settings in which the policies of a robot are evaluated, changed by `settings`.

    With adapters, the section `sim2real` of the robot applies, such as the control rate of a
    deployment. Its filters apply if robots respond late, because of an adapter or `world.response`.
    """
    data, source = evaluation_section(backend, robot)
    plain = from_mapping(EvalSettings, data, source, settings)
    if not (plain.world.adapters or plain.world.late):
        return plain
    changes = section("sim2real", robot)[0]
    world = changes.pop("world", None) or {}
    filters = {key: world.pop(key) for key in ("filters",) if key in world}
    if not plain.world.adapters:
        changes, world = {}, {}
    if plain.world.late:
        world |= filters
    changes["world"] = merged(data["world"], world)
    return from_mapping(EvalSettings, {**data, **changes}, source, settings)


def configure(
    robot: Robot,
    task: str,
    backend: str = "analytic",
    *,
    episodes: int | None = None,
    seed: int = 1,
    settings: Settings | None = None,
) -> EvalConfig:
    """Return an evaluation on a task by its name or YAML file.

    There are 500 episodes by default, or 50 with physics. `settings` are values by key of
    `EvalSettings`. Streams of targets have the filters of the section `servo` by default.

    Raises:
        KinfeasError: If the task is unknown or a setting is wrong.
    """
    config = read_settings(robot.folder, backend, settings)
    count = episodes or (500 if backend == "analytic" else 50)
    goals = load_task(task, config.task)
    if isinstance(goals, StreamTask) and not config.world.late:
        streamed = {"world.filters": section("servo", robot.folder)[0]["filters"]}
        config = read_settings(robot.folder, backend, nested(streamed, settings))
    return EvalConfig(robot, goals, count, seed, config.world, settings=settings or {})


def adapter_subsets(adapters: Sequence[PluginSpec]) -> dict[str, tuple[PluginSpec, ...]]:
    """Return no adapters, each one alone, and all but each one, by label, without duplicates.

    Adapters with the same name are numbered.
    """
    names = [adapter.name for adapter in adapters]
    labels = [
        name if names.count(name) == 1 else f"{name} {names[:n].count(name) + 1}"
        for n, name in enumerate(names)
    ]
    subsets: dict[str, tuple[PluginSpec, ...]] = {"none": ()}
    subsets |= {label: (adapter,) for label, adapter in zip(labels, adapters, strict=True)}
    for n, label in enumerate(labels):
        others = (*adapters[:n], *adapters[n + 1 :])
        if others not in subsets.values():
            subsets[f"no {label}"] = others
    return subsets


def evaluate(
    config: EvalConfig,
    policy: Policy,
    name: str = "",
    processes: int = 1,
    on_done: OnDone | None = None,
    watch: Watch | None = None,
) -> Summary:
    """Return the metrics of a policy: fractions in 0-1, distances in metres.

    The ceiling is null, see `add_ceiling`; further arguments as in `evaluate_episodes`. A single
    process calls `watch` after each step.
    """
    records, execution = run(config, policy, processes, on_done, watch)
    settings = config.world
    own = () if isinstance(config.task, StreamTask) else getattr(policy, "filters", ())
    filters = [*own, *(command_filter.name for command_filter in settings.filters)]
    return {
        "robot": config.robot.name, "task": config.task.name, "policy": name, "seed": config.seed,
        "world": settings.backend, "dt": settings.dt,
        "time_scale": execution.time_scale, "head_start": execution.head_start,
        "adapters": [adapter.name for adapter in settings.adapters],
        "filters": list(dict.fromkeys(filters)),
        "backend_parameters": settings.backend_parameters,
        "settings": to_mapping(nested(config.settings)), "version": __version__,
        **summarize(records),
        "failed": _failed(records, config.first),
        "per_episode": _per_episode(records, config.first),
        "ceiling": None, "ceiling_low": None, "ceiling_high": None,
    }  # fmt: skip


def run(
    config: EvalConfig,
    policy: Policy,
    processes: int = 1,
    on_done: OnDone | None = None,
    watch: Watch | None = None,
) -> tuple[EpisodeRecords, ExecutionConfig]:
    """Return the record of each episode, and the execution of motions within the adapters.

    Further arguments as in `evaluate`.
    """
    build = partial(World, config.robot, config.task, config.world, config.seed)
    episodes = range(config.first, config.first + config.episodes)
    with closed(world := build()):
        if processes == 1:
            records = run_episodes(world, policy, config.episodes, on_done, watch, config.first)
        else:
            records = evaluate_episodes(build, policy, episodes, processes, on_done)
    return records, world.loop.execution


def _failed(records: EpisodeRecords, first: int) -> dict[str, list[int]]:
    """Return the numbers of the failed episodes by reason, without reasons that do not occur."""
    collided, task_done = records.base_collisions, records.task_done
    done = records.success if task_done is None else records.success & task_done
    reasons = np.full(len(records.reached), "time", dtype=object)
    if collided is not None:
        reasons[collided > 0] = "collision"
    reasons[records.failures > 0] = "ik_failure"
    reasons[records.success] = "task"
    failed: dict[str, list[int]] = {}
    for row in np.flatnonzero(~done).tolist():
        failed.setdefault(reasons[row], []).append(first + row)
    return failed


def _per_episode(records: EpisodeRecords, first: int) -> dict[str, list[float | None]]:
    """Return the records that were measured as columns of a table; infinity is None, as in JSON."""
    episode = np.arange(first, first + len(records.reached))
    columns = {"episode": episode, "success": records.success, **vars(records)}
    return {
        name: [value if np.isfinite(value) else None for value in values.tolist()]
        for name, values in columns.items()
        if values is not None and values.ndim == 1
    }


def add_ceiling(
    summaries: Sequence[Summary],
    config: EvalConfig,
    on_done: Callable[[float], None] | None = None,
) -> None:
    """Write into summaries the fraction of episodes whose goals some base pose reaches.

    It stays null for streams of targets. `on_done` is called with the fraction of work just done.
    """
    if isinstance(config.task, StreamTask):
        return
    value, low, high = astuple(
        measure_reachability(
            config.robot, config.task, config.episodes, config.seed, config.world.ik, on_done
        ).share
    )
    for summary in summaries:
        summary["ceiling"], summary["ceiling_low"], summary["ceiling_high"] = value, low, high
