"""What commands read: the files and folders that none of their outputs may take the place of."""

from collections.abc import Sequence
from pathlib import Path

_PARTS = (
    "config.yaml",
    "metrics.csv",
    "evaluation.json",
    "checkpoints",
    "tensorboard",
    "policy.json",
    "policy.safetensors",
    "state.json",
    "state.safetensors",
)
"""What a training run and a checkpoint consist of."""


def named(name: str | Path | None) -> list[Path]:
    """Return the file that a robot, a task, a recipe and the like is named by, if it is one."""
    from kinfeas.io.files import is_path

    if name is None or not (isinstance(name, Path) or is_path(name) or Path(name).is_file()):
        return []
    return [Path(name)]


def of_policy(name: str | Path | None) -> list[Path]:
    """Return the file of a policy, or the files and folders of its training run."""
    if name is None:
        return []
    path = Path(str(name))
    return [path / part for part in _PARTS] if path.is_dir() else [path]


def of_demonstrations(folder: Path) -> list[Path]:
    """Return the recordings in a folder."""
    return [path for kind in ("csv", "npz") for path in folder.glob(f"*.{kind}")]


def of_settings(overrides: Sequence[str] | None) -> list[Path]:
    """Return the files that the values of assignments `KEY=VALUE` name."""
    values = (text.partition("=")[2].strip().strip("'\"") for text in overrides or ())
    return [path for value in values for path in named(value or None)]
