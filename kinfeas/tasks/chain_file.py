"""Chain tasks in YAML files, and those that are included."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from kinfeas import config
from kinfeas.config import strict_yaml
from kinfeas.core.errors import KinfeasError
from kinfeas.tasks.chain import ChainTask


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
    below = _read(Path(str(base)), (*extended_by, path.resolve()))
    return _changed(below, data, str(path))


def pick_place(**parameters: object) -> ChainTask:
    """Fetch an object from one table and put it down on another."""
    return _shipped("pick_place", parameters)


def door(**parameters: object) -> ChainTask:
    """Take the handle of a cupboard's door and open it."""
    return _shipped("door", parameters)


def drawer(**parameters: object) -> ChainTask:
    """Take the handle of a drawer and pull it open."""
    return _shipped("drawer", parameters)


def pick_place_cluttered(**parameters: object) -> ChainTask:
    """Fetch and put down an object among random solids and furniture."""
    return _shipped("pick_place_cluttered", parameters)


def door_cluttered(**parameters: object) -> ChainTask:
    """Open the door of a cupboard among random solids and furniture."""
    return _shipped("door_cluttered", parameters)


def drawer_cluttered(**parameters: object) -> ChainTask:
    """Open a drawer among random solids and furniture."""
    return _shipped("drawer_cluttered", parameters)


def shelf(**parameters: object) -> ChainTask:
    """Fetch an object from a board of a shelf and put it down on the next one."""
    return _shipped("shelf", parameters)


def room_door(**parameters: object) -> ChainTask:
    """Open the door of a room and pass through it."""
    return _shipped("room_door", parameters)


def _shipped(name: str, parameters: Mapping[str, object]) -> ChainTask:
    return read_chain(Path(__file__).parent / f"{name}.yaml", parameters)


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
