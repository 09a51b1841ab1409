"""Robots: a folder each, with model, URDF, recipes, ROS topics and trained policies.

May import core, config and io. The functions are entry points of the group `kinfeas.robots`.
"""

from pathlib import Path

_FOLDER = Path(__file__).parent


def pr2() -> Path:
    """Return the folder of the PR2: omnidirectional, right arm of seven joints."""
    return _FOLDER / "pr2"


def tiago() -> Path:
    """Return the folder of TIAGo: differential drive, torso lift and arm of seven joints."""
    return _FOLDER / "tiago"


def hsr() -> Path:
    """Return the folder of the HSR: omnidirectional, arm lift and four more joints."""
    return _FOLDER / "hsr"
