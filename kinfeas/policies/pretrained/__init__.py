"""Trained policies that the package ships: a folder for each robot.

Each has `policy.safetensors` and `policy.json`, with configuration, seed, figures and the command
that made it. `kinfeas benchmark` writes such folders as `OUT/pretrained`.
"""

from pathlib import Path

from kinfeas.core.errors import KinfeasError

NAME = "pretrained"
"""Name of the shipped policy of a robot."""

_ROOT = Path(__file__).parent


def robots() -> list[str]:
    """Return the sorted names of the robots with a shipped policy."""
    return sorted(path.parent.name for path in _ROOT.glob("*/policy.json"))


def find(robot: str) -> Path:
    """Return the folder of a robot's shipped policy."""
    if robot not in robots():
        raise KinfeasError(
            f"no pretrained policy for robot {robot!r}, only for: {', '.join(robots())}; "
            "train one with kinfeas train"
        )
    return _ROOT / robot
