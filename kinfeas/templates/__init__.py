"""Templates of distributions with a plugin.

The help of the command line imports this module, so it imports nothing else.
"""

from enum import StrEnum


class Kind(StrEnum):
    """Kinds of plugins with a template."""

    MOTION_GENERATOR = "motion_generator"
    ROBOT = "robot"
    TASK = "task"
    ADAPTER = "adapter"
    BACKEND = "backend"
    POLICY = "policy"
    FILTER = "filter"
    TARGET_SOURCE = "target_source"

    @property
    def group(self) -> str:
        """Entry-point group."""
        return "kinfeas.policies" if self is Kind.POLICY else f"kinfeas.{self}s"

    @property
    def target(self) -> str:
        """Class or function in the module, with the placeholders $Class and $name."""
        return "$name" if self in (Kind.ROBOT, Kind.TASK) else "$Class"
