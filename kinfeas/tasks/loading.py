"""Tasks by name, or by the path of their YAML."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

from kinfeas.core import registry
from kinfeas.core.errors import KinfeasError, check_name, is_own
from kinfeas.io.files import is_path
from kinfeas.tasks.chain import read_chain
from kinfeas.tasks.task import Subgoal, Task


def load_task(name_or_path: str, parameters: Mapping[str, object] | None = None) -> Task:
    """Return the task of a YAML file (`my/task.yaml`) or of an entry point (`ggr`).

    `parameters` are keyword parameters of the entry point, or changes to the file.

    Raises:
        KinfeasError: If there is no such task, it lacks sub-goals, or a parameter or its YAML is
            wrong.
    """
    if is_path(name_or_path):
        return read_chain(Path(name_or_path), parameters)
    task: Task = registry.build("kinfeas.tasks", name_or_path, parameters or {})
    if not is_own(task):
        _check(task, f"task {name_or_path!r}")
    return task


def task_name(name_or_path: str) -> str:
    """Return the name of a task in tables and file names: that of a path without its suffix."""
    return Path(name_or_path).stem if is_path(name_or_path) else name_or_path


def _check(task: Task, subject: str) -> None:
    """Raise KinfeasError if a plugin's task has no name or no sub-goals."""
    name, subgoals = getattr(task, "name", None), getattr(task, "subgoals", None)
    try:
        check_name(name if isinstance(name, str) else "")
    except ValueError as error:
        raise KinfeasError(f"{subject}: {error}") from error
    keys = [one.name for one in fields(Subgoal)]
    listed = subgoals if isinstance(subgoals, Sequence) else ()
    if not listed or not all(hasattr(subgoal, key) for subgoal in listed for key in keys):
        raise KinfeasError(f"{subject}: 'subgoals' must be a tuple of at least one Subgoal")
