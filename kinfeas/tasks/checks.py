"""A task whose every episode is looked at: nothing malformed gets into a loop."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from kinfeas.core.checks import are_unit, check_array
from kinfeas.core.errors import KinfeasError, check_name, plugin_note
from kinfeas.core.start import Start
from kinfeas.kinematics.ik import IkSolver
from kinfeas.tasks.task import Subgoal, Task


class CheckedTask:
    """A task that passes on another one's episodes if they have the right form.

    Exceptions of the task get a note that names it. Other attributes are those of the task.

    Args:
        task: Draws the episodes.
        name: What to call it in errors.

    Attributes:
        name: The task's own name.
        subgoals: Its sub-goals, as they were when this was made.

    Raises:
        KinfeasError: If the task has no name or no sub-goals; also from `sample`.
    """

    def __init__(self, task: Task, name: str) -> None:
        self.task, self.subject = task, f"task {name!r}"
        with plugin_note(self.subject):
            self.name, self.subgoals = task.name, task.subgoals
        self._check_name()
        self._check_subgoals()

    def sample(self, solver: IkSolver, rng: np.random.Generator) -> Start:
        """Return one random episode, its arrays without a leading axis."""
        with plugin_note(self.subject):
            start = self.task.sample(solver, rng)
        check_start(start, self.subject, len(self.subgoals), len(solver.robot.arm))
        return start

    def __getattr__(self, name: str) -> Any:
        # A plugin's class has attributes of its own, which scripts know; a copy in the making none.
        if name.startswith("__") or "task" not in vars(self):
            raise AttributeError(name)
        return getattr(self.task, name)

    def _check_name(self) -> None:
        if not isinstance(self.name, str):
            raise KinfeasError(f"{self.subject}: 'name' must be a string, not {self.name!r}")
        try:
            check_name(self.name)
        except ValueError as error:
            raise KinfeasError(f"{self.subject}: {error}") from error

    def _check_subgoals(self) -> None:
        if not isinstance(self.subgoals, Sequence) or not self.subgoals:
            got = "none" if isinstance(self.subgoals, Sequence) else type(self.subgoals).__name__
            raise KinfeasError(
                f"{self.subject} must have a tuple of at least one sub-goal, not {got}"
            )
        for subgoal in self.subgoals:
            lacks = next(
                (one.name for one in fields(Subgoal) if not hasattr(subgoal, one.name)), None
            )
            if lacks is not None:
                raise KinfeasError(
                    f"{self.subject} must have sub-goals that are a Subgoal each, and a "
                    f"{type(subgoal).__name__} has no {lacks!r}"
                )


def unchecked(task: Task) -> Task:
    """Return the task itself, to be asked of what class it is."""
    return task.task if isinstance(task, CheckedTask) else task


def check_start(start: Start, subject: str, subgoals: int, joints: int) -> None:
    """Do nothing if an episode has the form that it must have: the kernels do not look.

    Args:
        start: One episode, its arrays without a leading axis.
        subject: Whose it is, as the sentence begins.
        subgoals: How many sub-goals the task has.
        joints: How many joints the arm has.

    Raises:
        KinfeasError: If an array has another shape, or numbers that are not finite, or a pose no
            unit quaternion.
    """
    shapes = {"base_pose": (7,), "joint_positions": (joints,), "target_poses": (subgoals, 7)}
    for name, shape in shapes.items():
        value: Any = getattr(start, name, None)
        check_array(value, shape, f"{subject}: sampled {name}")
        if name != "joint_positions" and not are_unit(value):
            raise KinfeasError(f"{subject} samples a {name} whose quaternion is not of unit length")
