"""Tasks by name, or by the path of their YAML."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from kinfeas import config
from kinfeas.config import registry, strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import is_path
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import Subgoal, Task


def load_task(name_or_path: str, parameters: Mapping[str, object] | None = None) -> Task:
    """Return the task of a YAML file (`my/task.yaml`) or of an entry point (`ggr`).

    `parameters` are keyword parameters of the entry point, or changes to the file.

    Raises:
        KinfeasError: If there is no such task, or a parameter or its YAML is wrong.
    """
    if is_path(name_or_path):
        return read_chain(Path(name_or_path), parameters)
    task = registry.build("kinfeas.tasks", name_or_path, parameters or {})
    subgoals = task.subgoals
    if not isinstance(subgoals, Sequence) or not all(isinstance(s, Subgoal) for s in subgoals):
        raise KinfeasError(f"task {name_or_path!r}: 'subgoals' must be a tuple of Subgoal")
    return task


def task_name(name_or_path: str) -> str:
    """Return the name of a task in tables and file names: that of a path without its suffix."""
    return Path(name_or_path).stem if is_path(name_or_path) else name_or_path


def read_chain(path: Path, changes: Mapping[str, object] | None = None) -> ChainTask:
    """Return the task of a YAML file with the fields of `ChainTask`.

    Files that it names are searched for beside it, then in the current folder. `changes` replace
    its entries; a mapping that is not empty changes its own keys only, and entries of a list by
    index. In the same way the file changes the one that its key `extends` names.
    """
    data = _read(path)
    task = config.from_mapping(ChainTask, data, str(path))
    _check_places(task, task.places, str(path))
    if not changes:
        return task
    source = "the task's parameters"
    changed = config.from_mapping(ChainTask, _changed(data, changes, source), source)
    # Other sub-goals need not use all places of the file, but all places of the changes.
    changed_places = changes.get("places")
    _check_places(changed, changed_places if isinstance(changed_places, Mapping) else (), source)
    return changed


def _read(path: Path, extended_by: tuple[Path, ...] = ()) -> dict[str, object]:
    if path.resolve() in extended_by:
        raise KinfeasError(f"{path}: 'extends' leads back to this file")
    data = {key: _located(entry, path.parent) for key, entry in strict_yaml.read(path).items()}
    base = data.pop("extends", None)
    if base is None:
        return data
    extended = _read(Path(str(base)), (*extended_by, path.resolve()))
    return _changed(extended, data, str(path))


def _check_places(task: ChainTask, names: Iterable[str], source: str) -> None:
    for name in names:
        try:
            task.check_used(name, f"places.{name}")
        except ValueError as error:
            raise KinfeasError(f"{source}: {error}") from error


def _changed(data: Any, changes: Any, source: str) -> Any:
    return config.merged(data, changes, source, whole="generator")  # has parameters of its own


def _located(entry: object, folder: Path) -> object:
    """Return an entry in which names of files of a folder are replaced by their paths."""
    if isinstance(entry, Mapping):
        return {key: _located(value, folder) for key, value in entry.items()}
    if isinstance(entry, list):
        return [_located(value, folder) for value in entry]
    if isinstance(entry, str) and Path(entry).suffix:
        path = str(folder / entry)
        # Path.is_file raises if a name is too long.
        return path if os.path.isfile(path) else entry  # noqa: PTH113
    return entry
