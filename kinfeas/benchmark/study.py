"""A study: which robots, tasks and policies a benchmark puts side by side, and with which seeds."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from kinfeas import config
from kinfeas.benchmark.checks import check_names, check_robots, check_task
from kinfeas.benchmark.job import FILTERS
from kinfeas.config import Interval
from kinfeas.config.quantities import MOST_EPISODES, Count, Positive
from kinfeas.config.recipes import load_recipe
from kinfeas.core.errors import KinfeasError, no_such
from kinfeas.envs.world import WorldConfig, evaluation_world
from kinfeas.evaluation.evaluate import read_settings
from kinfeas.policies.loading import BASELINES
from kinfeas.robots.loading import load_robot

Seed = Annotated[int, Interval(low=0)]

PLAIN = "plain"
"""The row of physics in which nothing is different."""


@dataclass(frozen=True)
class Training:
    """How one robot's policies are learned, one for each training seed.

    Attributes:
        robot: Name or YAML file.
        algorithm: `sac` or `td3`.
        recipe: Name or file; by default the section `train` of the robot.
        settings: Assignments `a.b=c` that win over the recipe.
        steps: Environment steps in all; the recipe's schedule if neither is set.
        minutes: Wall-clock time in all.
    """

    robot: str
    algorithm: Literal["sac", "td3"] = "sac"
    recipe: str | None = None
    settings: tuple[str, ...] = ()
    steps: Count | None = None
    minutes: Positive | None = None


@dataclass(frozen=True)
class Row:
    """A row of learned policies in the tables.

    Attributes:
        robots: For which of the study's robots; null for all.
        tasks: On which of its tasks; null for all.
    """

    robots: tuple[str, ...] | None = None
    tasks: tuple[str, ...] | None = None

    def holds(self, robot: str, task: str) -> bool:
        """Return whether there is a cell in it for a robot on a task."""
        return (self.robots is None or robot in self.robots) and (
            self.tasks is None or task in self.tasks
        )


@dataclass(frozen=True)
class Aid(Row):
    """A row of policies that have help; of several algorithms SAC's alone.

    Attributes:
        feasibility_filter: Whether the feasibility filter is on.
        rollout_planner: They look ahead.
    """

    feasibility_filter: bool = False
    rollout_planner: bool = False

    def __post_init__(self) -> None:
        """Check that there is any."""
        if not (self.feasibility_filter or self.rollout_planner):
            raise ValueError("one of 'feasibility_filter' and 'rollout_planner' must be true")

    @property
    def prefix(self) -> str:
        """What stands before the names of the policies in its row."""
        return "".join(f"{one}:" for one in FILTERS if getattr(self, one))


@dataclass(frozen=True)
class Variant:
    """A task with other parameters, in a table of its own.

    Attributes:
        label: What is different, such as `goals up to 1.4 m`.
        task: Its name or YAML file.
        parameters: Its keyword parameters.
        robots: For whom.
    """

    label: str
    task: str
    parameters: dict[str, object]
    robots: tuple[str, ...]


@dataclass(frozen=True)
class PhysicsRow(Row):
    """One of the rows in which learned policies stand in the table of physics.

    Attributes:
        settings: Assignments such as `world.head_start=3` to what suits each robot.
    """

    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class PhysicsBenchmark:
    """What a study asks of the PyBullet world.

    Attributes:
        settings: Assignments for all rows, the baselines' too, such as `world.time_scale=1`.
        rows: The rows of the learned policies, by name; in `plain` the baselines stand, too.
    """

    settings: tuple[str, ...] = ()
    rows: dict[str, PhysicsRow] = field(default_factory=lambda: {PLAIN: PhysicsRow()})

    def __post_init__(self) -> None:
        """Check that there is a row for the baselines."""
        if PLAIN not in self.rows:
            raise ValueError(f"'rows' must have the entry {PLAIN!r}")


@dataclass(frozen=True)
class BenchmarkConfig:
    """The schema of `configs/benchmark/*.yaml`, but for `paper.yaml`.

    What concerns a robot or a task that takes no part is left out, so that `robots` and `tasks`
    can be made fewer.

    Attributes:
        note: A sentence that stands above the tables.
        robots: Names or YAML files.
        tasks: Names or YAML files.
        baselines: On which of the tasks each baseline is judged.
        aids: With what learned policies are judged once more; with physics beside the plain row.
        policies: Whether to `train` the learned policies, to take those that come with the package
            (`pretrained`), or to train only where none comes with it (`either`).
        trainings: How they are learned.
        seeds: Training seeds of each.
        episodes: Of each policy on each task.
        evaluation_seed: Of these episodes, the same for all.
        variants: Further rows.
        world: Where all of it happens.
        physics: Null for a study of the analytic world; else the same happens in the PyBullet
            world, too, and `variants` are left out.
    """

    note: str = ""
    robots: tuple[str, ...] = ("pr2", "tiago", "hsr")
    tasks: tuple[str, ...] = ("ggr", "ggr_restricted")
    baselines: dict[str, tuple[str, ...]] = field(default_factory=dict)
    aids: tuple[Aid, ...] = ()
    policies: Literal["train", "pretrained", "either"] = "train"
    trainings: tuple[Training, ...] = ()
    seeds: tuple[Seed, ...] = (0,)
    episodes: Count = 500
    evaluation_seed: Seed = 1
    variants: tuple[Variant, ...] = ()
    world: WorldConfig = field(default_factory=evaluation_world)
    physics: PhysicsBenchmark | None = None

    def __post_init__(self) -> None:
        """Check the baselines' names, how many episodes there are, and that nothing is twice."""
        for name in self.baselines:
            if name not in BASELINES:
                raise ValueError(f"unknown baseline {name!r}{no_such(name, BASELINES)}")
        if self.episodes > MOST_EPISODES:
            raise ValueError(f"'episodes' must be at most {MOST_EPISODES}, not {self.episodes}")
        for key in ("robots", "tasks", "seeds"):
            entries = getattr(self, key)
            if not entries or len(set(entries)) < len(entries):
                raise ValueError(f"{key!r} must hold at least one entry, and none twice")
        self._check_aids()
        self._check_variants()

    def _check_aids(self) -> None:
        """Raise if two aids would be one row of a robot on a task."""
        for robot in self.robots:
            for task in self.tasks:
                rows = [aid.prefix for aid in self.aids if aid.holds(robot, task)]
                if len(set(rows)) < len(rows):
                    raise ValueError(
                        f"two entries of 'aids' help {robot} on {task} in the same way; "
                        "their 'robots' or 'tasks' must tell them apart"
                    )

    def _check_variants(self) -> None:
        """Raise if two variants would be rows of one name, or one has no name."""
        taken: set[tuple[str, str, str]] = set()
        for variant in self.variants:
            if not variant.label.strip():
                raise ValueError("every entry of 'variants' must have a 'label' that is not empty")
            rows = {(variant.label, variant.task, robot) for robot in variant.robots}
            if len(rows) < len(variant.robots) or rows & taken:
                raise ValueError(
                    f"'variants' has the label {variant.label!r} of the task {variant.task!r} "
                    "twice for a robot; each needs a label of its own"
                )
            taken |= rows


def read_benchmark(name: str, overrides: Sequence[str] = ()) -> BenchmarkConfig:
    """Return a study by its recipe's name or file.

    Raises:
        KinfeasError: If there is none, or it is wrong: a key, a value, a robot, a task, a task's
            motion or scene; or if two robots or two tasks would have the same name in the tables.
    """
    study = load_recipe(BenchmarkConfig, name, "benchmark", overrides)
    named = [*study.robots, *(training.robot for training in study.trainings)]
    named += [robot for variant in study.variants for robot in variant.robots]
    named += [robot for aid in study.aids for robot in aid.robots or ()]
    for robot in dict.fromkeys(named):
        load_robot(robot)
    check_robots(study.robots)
    check_names(study.tasks)
    judged = [task for tasks in study.baselines.values() for task in tasks]
    judged += [task for aid in study.aids for task in aid.tasks or ()]
    plain: list[tuple[str, dict[str, object]]] = [
        (task, {}) for task in dict.fromkeys([*study.tasks, *judged])
    ]
    for task, parameters in [*plain, *((one.task, one.parameters) for one in study.variants)]:
        check_task(task, parameters, physical=study.physics is not None)
    if study.physics is not None:
        for robot in study.robots:
            for row in study.physics.rows.values():
                row_settings(study.physics, row, robot)
    return study


def row_settings(physics: PhysicsBenchmark, row: PhysicsRow, robot: str) -> WorldConfig:
    """Return the PyBullet world of one robot in one row.

    Raises:
        KinfeasError: If a setting is wrong, or is none of the world.
    """
    said = [*physics.settings, *row.settings]
    known = read_settings(load_robot(robot).name, "pybullet", said)
    if ignored := sorted(config.assigned(said).keys() - {"world"}):
        raise KinfeasError(
            f"the settings of 'physics' in a study may be world.KEY=VALUE, not {ignored[0]}.KEY"
        )
    return known.world


def restricted(study: BenchmarkConfig, names: Collection[str]) -> BenchmarkConfig:
    """Return a study of those of its robots that have one of `names`.

    Raises:
        KinfeasError: If the study lacks one of these robots.
    """
    robots = {load_robot(robot).name: robot for robot in study.robots}
    if unknown := sorted(set(names) - set(robots)):
        raise KinfeasError(
            f"the study has no robot {unknown[0]!r}, only: {', '.join(sorted(robots))}; "
            "--set robots=[...] changes that"
        )
    return replace(study, robots=tuple(robot for name, robot in robots.items() if name in names))
