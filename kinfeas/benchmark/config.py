"""Configuration of a benchmark: robots, tasks, policies, and further rows and tables of them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from annotated_types import MinLen

from kinfeas import config
from kinfeas.config import PluginSpec, Settings, nested, registry
from kinfeas.config.recipes import find_recipe
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.core.quantities import Count, Episodes, Positive, Seed
from kinfeas.evaluation.evaluate import read_settings
from kinfeas.policies.loading import GROUP
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task, task_name
from kinfeas.tasks.task import StreamTask, build_subgoals

Label = Annotated[str, MinLen(1)]


@dataclass(frozen=True)
class Training:
    """Training of one robot's policies, one for each training seed."""

    robot: str  # name or folder
    recipe: str | None = None  # name or file; the section `train` of the robot by default
    settings: dict[str, object] = field(default_factory=dict)  # values by key of the recipe
    steps: Count | None = None  # environment steps in all; the recipe's schedule if neither is set
    minutes: Positive | None = None  # wall-clock time in all


@dataclass(frozen=True)
class Row:
    """A further row of the learned policies."""

    # name of the row; rows `head_start` and `no_objects` also show the paper's figures for these
    label: Label
    # command filters of this row; those of the world by default
    filters: tuple[PluginSpec, ...] | None = None
    # values by key of the evaluation, such as `world.head_start`
    settings: dict[str, object] = field(default_factory=dict)
    robots: tuple[str, ...] | None = None  # robots that have it; all by default
    tasks: tuple[str, ...] | None = None  # tasks that have it; all by default

    def has(self, robot: str, task: str) -> bool:
        """Return whether a robot has the row on a task."""
        of_robot = self.robots is None or robot in self.robots
        return of_robot and (self.tasks is None or task in self.tasks)


@dataclass(frozen=True)
class Variant:
    """A task with other parameters, in a table of its own."""

    label: Label  # title of the table, such as `goals up to 1.4 m`
    task: str  # name or YAML file
    parameters: dict[str, object]  # its keyword parameters
    robots: tuple[str, ...]  # robots that have it


@dataclass(frozen=True)
class BenchmarkConfig:
    """The schema of `configs/benchmark/*.yaml`, except for `paper.yaml`.

    Rows, variants, trainings and baselines are left out if their robots or tasks are not listed, so
    that `robots` and `tasks` can be shortened.
    """

    note: str = ""  # a sentence above the tables
    robots: tuple[str, ...] = ("pr2", "tiago", "hsr")  # names or folders
    tasks: tuple[str, ...] = ("ggr", "ggr_restricted")  # names or YAML files
    # tasks by baseline; a baseline is a policy's name or `module:Class`
    baselines: dict[str, tuple[str, ...]] = field(default_factory=dict)
    rows: tuple[Row, ...] = ()  # further rows of the learned policies
    # whether to `train` the learned policies, to take the shipped ones (`pretrained`), or to train
    # only robots without a shipped one (`either`)
    policies: Literal["train", "pretrained", "either"] = "train"
    trainings: tuple[Training, ...] = ()  # training of the policies
    seeds: tuple[Seed, ...] = (0,)  # training seeds of each policy
    episodes: Episodes = 500  # episodes of each policy on each task
    evaluation_seed: Seed = 1  # seed of these episodes, the same for all
    variants: tuple[Variant, ...] = ()  # further tables, in the analytic world only
    # entry point in the group kinfeas.backends. Tables of other backends than `analytic` also have
    # the same policies in the analytic world
    backend: str = "analytic"
    # values by key of the evaluations, such as `world.time_scale`
    settings: dict[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the names of the baselines, and that no row of a table occurs twice."""
        policies = registry.names(GROUP)
        for name in self.baselines:
            if name not in policies and ":" not in name:
                raise ValueError(f"'baselines': unknown {name!r}{no_such(name, policies)}")
        cells = [(r, t) for r in self.robots for t in self.tasks]
        entries: dict[str, Sequence[object]] = {
            "robots": self.robots,
            "tasks": self.tasks,
            "seeds": self.seeds,
            "rows": [(row.label, *cell) for row in self.rows for cell in cells if row.has(*cell)],
            "variants": [(v.label, v.task, robot) for v in self.variants for robot in v.robots],
        }
        for key, values in entries.items():
            if len(set(values)) < len(values) or (not values and key not in ("rows", "variants")):
                raise ValueError(f"{key!r} must hold at least one entry, and none twice")


def read_benchmark(name: str, settings: Settings | None = None) -> BenchmarkConfig:
    """Return a benchmark by its recipe's name or file.

    Raises:
        KinfeasError: If the recipe does not exist; a key, a robot, a task, its motion or a setting
            is invalid; or two robots or tasks have the same name.
    """
    benchmark = config.load(BenchmarkConfig, find_recipe(name, "benchmark"), settings)
    robots = [load_robot(robot).name for robot in benchmark.robots]
    tasks = [task_name(task) for task in benchmark.tasks]
    for kind, names in (("robots", robots), ("tasks", tasks)):
        if len(set(names)) < len(names):
            raise KinfeasError(f"{kind!r} must not hold two of one name: {', '.join(names)}")
    for task, parameters in (
        *((task, {}) for task in benchmark.tasks),
        *((variant.task, variant.parameters) for variant in benchmark.variants),
    ):
        model = load_task(task, parameters)
        if isinstance(model, StreamTask):
            raise KinfeasError(f"'tasks': {task} has no ceiling, since its targets move")
        build_subgoals(model.subgoals)
    for robot in benchmark.robots:
        for row in (Row(""), *benchmark.rows):
            read_settings(robot, benchmark.backend, nested(benchmark.settings, row.settings))
    return benchmark


def restricted(benchmark: BenchmarkConfig, names: Collection[str]) -> BenchmarkConfig:
    """Return a benchmark with only the named robots; raise KinfeasError for an unknown name."""
    robots = {load_robot(robot).name: robot for robot in benchmark.robots}
    for name in names:
        if name not in robots:
            raise KinfeasError(f"the benchmark has no robot {name!r}{no_such(name, robots)}")
    return replace(
        benchmark, robots=tuple(robot for name, robot in robots.items() if name in names)
    )
