"""What a base policy is, and what it gets."""

from dataclasses import dataclass
from typing import Protocol

from kinfeas.core.spatial import Array


@dataclass(frozen=True)
class PolicyInput:
    """All that a policy may look at, for n robots.

    Attributes:
        observation: What a learned policy sees, shape (n, 21 + j).
        base_pose: World pose of the base, shape (n, 7).
        ee_pose: Achieved world pose of the EE, shape (n, 7).
        desired: Desired world pose of the EE now, shape (n, 7).
        planned: Desired world pose in `observation.HORIZON` seconds, shape (n, 7). Where the motion
            is slowed down it is nearer than what the observation shows, which is always at full
            pace.
        demonstrated_base: World pose at which the base was demonstrated to be now, shape (n, 7);
            NaN where none was.
    """

    observation: Array
    base_pose: Array
    ee_pose: Array
    desired: Array
    planned: Array
    demonstrated_base: Array


class Policy(Protocol):
    """Moves the base."""

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        ...
