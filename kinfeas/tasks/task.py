"""What a task is."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from kinfeas.config.quantities import Seconds
from kinfeas.control.execution import Frame, SubgoalMotion
from kinfeas.core import registry
from kinfeas.core.backend import Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import MotionGenerator
from kinfeas.core.registry import MissingParameterError
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver


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
class Subgoal:
    """One motion of a chain.

    Attributes:
        motion: What moves the frame.
        frame: Whether that is the EE frame or the tool tip in the common gripper convention, whose
            x is the approach and whose y the finger axis.
        dwell: Seconds that the EE stands still after its arrival, while the base may move; the last
            sub-goal ends with the arrival.
        grip: What the gripper does then, in worlds that have one.
    """

    motion: MotionSpec = field(default_factory=MotionSpec)
    frame: Frame = "ee"
    dwell: Seconds = 0.0
    grip: Grip | None = None


class Task(Protocol):
    """Draws the episodes that policies are trained and judged on.

    Attributes:
        name: Short name.
        subgoals: The motions that the EE makes one after the other, at least one.
    """

    @property
    def name(self) -> str: ...  # noqa: D102 - see above

    @property
    def subgoals(self) -> tuple[Subgoal, ...]: ...  # noqa: D102 - see above

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis: (7,), (j,), (sub-goals, 7).

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


@runtime_checkable
class SupportsTaskScenes(Protocol):
    """A backend that sets up the scene of a task."""

    def stage(self, task: Task) -> Task:
        """Return the task, set up in this backend: a `StagedTask`."""
        ...


@runtime_checkable
class ReportsTaskSuccess(Protocol):
    """A staged task that measures in the backend whether it was done."""

    def task_done(
        self, row: int, joint_positions: Array, dt: float, *, reached: bool
    ) -> bool | None:
        """Return whether the episode that ends in a row did its task; None if unknown.

        Args:
            row: Row of the episode.
            joint_positions: Arm joints of all rows, shape (n, j).
            dt: Control period in seconds.
            reached: Whether the episode reached its goal.
        """
        ...


def build_subgoals(subgoals: Sequence[Subgoal]) -> tuple[SubgoalMotion, ...]:
    """Return sub-goals with their generators; those of equal motions share one.

    Raises:
        KinfeasError: If there is no such generator, or a parameter is wrong; of several sub-goals,
            the sentence names the one.
    """
    built: list[SubgoalMotion] = []
    for number, subgoal in enumerate(subgoals):
        known = next(
            (b for a, b in zip(subgoals, built, strict=False) if a.motion == subgoal.motion), None
        )
        where = f"subgoals.{number}.motion" if len(subgoals) > 1 else "motion"
        generator = known.generator if known else _build(subgoal.motion, where)
        built.append(
            SubgoalMotion(
                generator, subgoal.frame, subgoal.dwell, subgoal.grip, subgoal.motion.generator
            )
        )
    return tuple(built)


def _build(motion: MotionSpec, where: str) -> MotionGenerator:
    try:
        generator: MotionGenerator = registry.build(
            "kinfeas.motion_generators", motion.generator, motion.parameters
        )
    except KinfeasError as error:
        hint = ""
        if isinstance(missing := error.__cause__, MissingParameterError):
            hint = f": --set task.{where}.parameters.{missing.parameter}=VALUE"
        named = "" if where == "motion" else f"'{where}': "
        raise KinfeasError(f"{named}{error}{hint}") from error
    return generator
