"""Trained policies that come with the package: a folder for each robot that has one.

Each holds `policy.safetensors` and `policy.json`, which names configuration, seed, figures and the
command that made it. `kinfeas benchmark --publish` writes such folders.
"""

from importlib.resources import files
from pathlib import Path

from kinfeas.core.errors import KinfeasError

NAME = "pretrained"
"""What `--policy` calls the shipped policy of whatever robot is asked for."""


def robots(root: Path | None = None) -> list[str]:
    """Return the sorted names of the robots that have a policy.

    Args:
        root: Where the folders lie; those of the package by default.
    """
    place = _shipped() if root is None else root
    return sorted(path.parent.name for path in place.glob("*/policy.json"))


def find(robot: str, root: Path | None = None) -> Path:
    """Return the folder of a robot's policy.

    Args:
        robot: Name of the robot.
        root: Where the folders lie; those of the package by default.

    Raises:
        KinfeasError: If no policy comes with the package for this robot.
    """
    known = robots(root)
    if robot not in known:
        raise KinfeasError(
            f"there is no pretrained policy for robot {robot!r}, only for: "
            f"{', '.join(known) or 'none'}; train one with kinfeas train and the same --robot"
        )
    return (_shipped() if root is None else root) / robot


def _shipped() -> Path:
    return Path(str(files("kinfeas.policies.pretrained").joinpath("")))
