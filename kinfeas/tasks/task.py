"""What a task is."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from kinfeas.kinematics.ik import IkSolver
from kinfeas.start import Start


@dataclass(frozen=True)
class MotionSpec:
    """A motion generator by name.

    Attributes:
        generator: Entry-point name in the group kinfeas.motion_generators.
        parameters: Its keyword parameters.
    """

    generator: str = "linear"
    parameters: dict[str, object] = field(default_factory=dict)


class Task(Protocol):
    """Draws the episodes that policies are trained and judged on."""

    name: str
    motion: MotionSpec

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis.

        Args:
            solver: The robot's kinematics.
            rng: The only source of randomness, so that an episode is a function of its seed.
        """
        ...
