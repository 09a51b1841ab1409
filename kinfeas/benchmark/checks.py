"""What can be wrong with a study though each of its entries is in order, before hours go by."""

from collections.abc import Mapping, Sequence

from kinfeas.backends.pybullet.stage import task_scene
from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import is_path
from kinfeas.robots.loading import load_robot
from kinfeas.tasks.loading import load_task, task_name
from kinfeas.tasks.task import build_subgoals


def check_robots(robots: Sequence[str]) -> None:
    """Raise if two robots have one name: the tables would not tell them apart."""
    taken: dict[str, str] = {}
    for robot in robots:
        name = load_robot(robot).name
        if (other := taken.setdefault(name, robot)) != robot:
            raise KinfeasError(
                f"'robots' must not hold two of one name, and {other} and {robot} are both {name!r}"
            )


def check_task(task: str, parameters: Mapping[str, object], *, physical: bool) -> None:
    """Raise if a task, one of its motions or, with physics, its scene cannot be read."""
    known = load_task(task, parameters)
    build_subgoals(known.subgoals)
    if physical:
        task_scene(known)


def check_names(tasks: Sequence[str]) -> None:
    """Raise if the file of a task has the name of another task, installed or of the study."""
    taken = {name: name for name in registry.names("kinfeas.tasks")}
    for task in filter(is_path, tasks):
        other = taken.setdefault(task_name(task), task)
        if other != task:
            raise KinfeasError(
                f"{task}: would have the name of the task {other!r} in the tables; rename the file"
            )
