"""Templates: small distributions that work at once, for plugins of one's own.

Here is only what there are templates of: the command line reads it for its help, and must not load
more than that.
"""

from enum import StrEnum


class Kind(StrEnum):
    """What a distribution may offer."""

    MOTION_GENERATOR = "motion_generator"
    ROBOT = "robot"
    TASK = "task"
    ADAPTER = "adapter"
    BACKEND = "backend"
    POLICY = "policy"
    FILTER = "filter"

    @property
    def group(self) -> str:
        """Entry-point group."""
        return "kinfeas.policies" if self is Kind.POLICY else f"kinfeas.{self}s"

    @property
    def target(self) -> str:
        """Class or function in its module, with $Class and $name for what it is called."""
        return "$name" if self in (Kind.ROBOT, Kind.TASK) else "$Class"
