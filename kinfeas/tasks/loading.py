"""Tasks by name, or by the path of their YAML."""

from collections.abc import Mapping
from pathlib import Path

from kinfeas.core import registry
from kinfeas.io.files import is_path
from kinfeas.tasks.chain_file import read_chain
from kinfeas.tasks.task import Task


def load_task(name_or_path: str, parameters: Mapping[str, object] | None = None) -> Task:
    """Return the task of a YAML file (`my/task.yaml`) or of an entry point (`ggr`).

    `parameters` are keyword parameters of the entry point, or changes to the file.

    Raises:
        KinfeasError: If there is no such task, or a parameter or its YAML is wrong.
    """
    if is_path(name_or_path):
        return read_chain(Path(name_or_path), parameters)
    return registry.build("kinfeas.tasks", name_or_path, parameters or {})


def task_name(name_or_path: str) -> str:
    """Return the name of a task in tables and file names: that of a path without its suffix."""
    return Path(name_or_path).stem if is_path(name_or_path) else name_or_path
