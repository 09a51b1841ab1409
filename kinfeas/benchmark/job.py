"""What a benchmark has to find: one figure, of a policy on a task or of the task itself."""

from dataclasses import dataclass, replace
from pathlib import Path

from kinfeas.config import PluginSpec
from kinfeas.envs.world import WorldConfig
from kinfeas.tasks.loading import task_name

CEILING = "ceiling"
"""What takes the place of a policy where the ceiling of a task is to be found."""

FILTERS = ("rollout_planner", "feasibility_filter")
"""Prefixes of a policy's name in the table, each with a colon, of filters in its row alone."""


@dataclass(frozen=True, eq=False)
class Job:
    """One figure to find: a policy on a task, or the task's ceiling.

    Attributes:
        robot: Name or YAML file.
        task: Name or YAML file.
        parameters: Its keyword parameters.
        variant: What is different about them.
        policy: Name of the policy in the table, with `rollout_planner:` and `feasibility_filter:`
            before it where they are on; `ceiling` for the ceiling.
        source: What `load_policy` takes.
        training_seed: Seed that it was trained with, if it was and that is known.
        episodes: How many.
        seed: Of the episodes.
        world: Where they happen.
        first: Number of the first episode; of physics alone, whose episodes come in parts.
    """

    robot: str
    task: str
    parameters: dict[str, object]
    variant: str
    policy: str
    source: str
    training_seed: int | None
    episodes: int
    seed: int
    world: WorldConfig
    first: int = 0

    @property
    def physical(self) -> bool:
        """Whether it happens in the PyBullet world."""
        return self.world.backend != "analytic"

    @property
    def task_name(self) -> str:
        """What its task is called in tables."""
        return task_name(self.task)

    @property
    def aided(self) -> bool:
        """Whether its policy has filters or a planner in a row of its own."""
        return ":" in self.policy

    @property
    def name(self) -> str:
        """What it is called in errors and as a file."""
        seed = "" if self.training_seed is None else f"-{self.training_seed}"
        variant = "" if not self.variant else "-variant"
        part = f"-pybullet-{self.first}" if self.physical else ""
        policy = self.policy.replace(":", "-")
        return f"{Path(self.robot).stem}-{self.task_name}{variant}-{policy}{seed}{part}"


def world_for(policy: str, world: WorldConfig) -> WorldConfig:
    """Return the world of a policy by its name in the table, with the filters in its name."""
    named = [one.removesuffix("_filter") for one in FILTERS if f"{one}:" in policy]
    present = [one.name for one in world.filters]
    before: list[PluginSpec] = [PluginSpec(one) for one in named if one == FILTERS[0]]
    late = [one for one in named if one != FILTERS[0] and one not in present]
    after: list[PluginSpec] = [PluginSpec(one) for one in late]
    return replace(world, filters=(*before, *world.filters, *after))
