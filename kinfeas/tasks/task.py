"""What a task is."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from kinfeas import registry
from kinfeas.backend import Grip
from kinfeas.errors import KinfeasError
from kinfeas.kinematics.ik import IkSolver
from kinfeas.legs import Frame, LegMotion
from kinfeas.motion import MotionGenerator
from kinfeas.quantities import Seconds
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


@dataclass(frozen=True)
class Leg:
    """One motion of a chain.

    Attributes:
        motion: What moves the frame.
        frame: Whether that is the EE frame or the tool tip in the common gripper convention, whose
            x is the approach and whose y the finger axis.
        wait: Seconds that the EE stands still after its arrival, while the base may move; the last
            leg ends with the arrival.
        grip: What the gripper does then, in worlds that have one.
    """

    motion: MotionSpec = field(default_factory=MotionSpec)
    frame: Frame = "ee"
    wait: Seconds = 0.0
    grip: Grip | None = None


class Task(Protocol):
    """Draws the episodes that policies are trained and judged on.

    Attributes:
        name: Short name.
        legs: The motions that the EE makes one after the other, at least one.
    """

    @property
    def name(self) -> str: ...  # noqa: D102 - see above

    @property
    def legs(self) -> tuple[Leg, ...]: ...  # noqa: D102 - see above

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis: (7,), (j,), (legs, 7).

        Args:
            solver: The robot's kinematics.
            rng: The only source of randomness, so that an episode is a function of its seed.
        """
        ...


@runtime_checkable
class StagedTask(Protocol):
    """A task that also places objects in the backend when it draws an episode."""

    def sample_in(self, row: int, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, as `Task.sample` does, and prepare the robot's row for it."""
        ...


def build_legs(legs: Sequence[Leg]) -> tuple[LegMotion, ...]:
    """Return legs with their generators; those of equal motions share one.

    Raises:
        KinfeasError: If there is no such generator, or a parameter is wrong; of several legs, the
            sentence names the one.
    """
    built: list[LegMotion] = []
    for number, leg in enumerate(legs):
        known = next((b for a, b in zip(legs, built, strict=False) if a.motion == leg.motion), None)
        where = f"'legs.{number}.motion': " if len(legs) > 1 else ""
        generator = known.generator if known else _build(leg.motion, where)
        built.append(LegMotion(generator, leg.frame, leg.wait, leg.grip, leg.motion.generator))
    return tuple(built)


def _build(motion: MotionSpec, where: str) -> MotionGenerator:
    try:
        generator: MotionGenerator = registry.build(
            "kinfeas.motion_generators", motion.generator, motion.parameters
        )
    except KinfeasError as error:
        raise KinfeasError(f"{where}{error}") from error
    return generator
