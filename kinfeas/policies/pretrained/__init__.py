"""Trained policies that the package ships: a folder for each robot.

Each has `policy.safetensors` and `policy.json`, with configuration, seed, figures and the command
that made it. `kinfeas benchmark --publish` writes such folders.
"""

from importlib.resources import files
from pathlib import Path

from kinfeas.core.errors import KinfeasError

NAME = "pretrained"
"""Name of the shipped policy of a robot."""


def robots(root: Path | None = None) -> list[str]:
    """Return the sorted names of the robots with a shipped policy, or of those below `root`."""
    return sorted(path.parent.name for path in (root or _shipped()).glob("*/policy.json"))


def find(robot: str, root: Path | None = None) -> Path:
    """Return the folder of a robot's shipped policy, or of one below `root`."""
    known = robots(root)
    if robot not in known:
        raise KinfeasError(
            f"no pretrained policy for robot {robot!r}, only for: {', '.join(known) or 'none'}; "
            "train one with kinfeas train"
        )
    return (root or _shipped()) / robot


def _shipped() -> Path:
    return Path(str(files("kinfeas.policies.pretrained").joinpath("")))
