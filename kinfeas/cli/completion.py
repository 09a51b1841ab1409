"""What the shell offers after a Tab: names only, found without importing anything heavy."""

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

POLICIES = (
    "pretrained",
    "follow_ee",
    "follow_ee_feedback",
    "demonstrated_base",
    "geometric_modulation",
    "whole_body_qp",
)
"""Policies that have a name; a test holds them against the real list, which is slow to import."""

_GROUPS = ("motion_generators", "robots", "tasks", "adapters", "backends")

Complete = Callable[[str], list[str]]


def plugins(*groups: str) -> Complete:
    """Return a completion by the names of entry points, such as those of `robots`."""

    def complete(incomplete: str) -> list[str]:
        names = {one.name for group in groups for one in entry_points(group=f"kinfeas.{group}")}
        return _beginning(incomplete, names)

    return complete


def every_plugin(incomplete: str) -> list[str]:
    """Return the names of all plugins that begin so."""
    return plugins(*_GROUPS)(incomplete)


def policies(incomplete: str) -> list[str]:
    """Return the policies that have a name, and the training runs here, that begin so."""
    runs = {str(path.parent) for path in Path("runs").glob("*/config.yaml")}
    return _beginning(incomplete, {*POLICIES, *runs})


def _beginning(incomplete: str, names: set[str]) -> list[str]:
    return sorted(name for name in names if name.startswith(incomplete))
