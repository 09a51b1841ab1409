"""Tasks by name, or by the path of their YAML."""

import os
from collections.abc import Mapping
from pathlib import Path

from kinfeas import registry
from kinfeas.tasks.chain import read_chain
from kinfeas.tasks.task import Task


def load_task(name_or_path: str, parameters: Mapping[str, object] | None = None) -> Task:
    """Return the task of a YAML file (`my/task.yaml`) or of an entry point (`ggr`).

    Args:
        name_or_path: What is to be loaded.
        parameters: Keyword parameters of the entry point, or changes to the file.

    Raises:
        KinfeasError: If there is no such task, or a parameter or its YAML is wrong.
    """
    if os.sep in name_or_path or name_or_path.endswith((".yaml", ".yml")):
        return read_chain(Path(name_or_path), parameters)
    task: Task = registry.build("kinfeas.tasks", name_or_path, parameters or {})
    return task
