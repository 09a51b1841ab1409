"""Robot models from a URDF and a YAML file, and the included robots.

May import core, config and io. The functions are entry points of the group `kinfeas.robots`.
"""

from pathlib import Path

_FOLDER = Path(__file__).parent


def pr2() -> Path:
    """Return the YAML file of the PR2: omnidirectional, right arm of seven joints."""
    return _FOLDER / "pr2.yaml"


def tiago() -> Path:
    """Return the YAML file of TIAGo: differential drive, torso lift and arm of seven joints."""
    return _FOLDER / "tiago.yaml"


def hsr() -> Path:
    """Return the YAML file of the HSR: omnidirectional, arm lift and four more joints."""
    return _FOLDER / "hsr.yaml"
