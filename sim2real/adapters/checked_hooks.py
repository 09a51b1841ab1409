"""The hooks of an adapter whose every answer is looked at: nothing malformed gets to a robot."""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import RobotState
from kinfeas.core.checks.answers import Answers
from kinfeas.core.plugin_errors import BLAMED, PluginErrors, package_of
from kinfeas.core.spatial import Array


class Hooks(Protocol):
    """What a subclass of `Adapter` overrides."""

    def on_reset(self, state: RobotState) -> dict[str, NDArray[Any]]:
        """Return what to remember from now on."""
        ...

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist and the joint targets that are passed on."""
        ...

    def on_step(self, state: RobotState, dt: float) -> None:
        """Take note of what was measured."""
        ...

    def modify_state(self, state: RobotState) -> RobotState:
        """Return what is seen of what was measured."""
        ...


class CheckedHooks:
    """Hooks that pass on others' answers if they have the right form.

    Numbers must be finite where those that the hook was given are. What the hooks' own code raises
    becomes an error that names it and the line.

    Args:
        hooks: Who answers.
        subject: What to call it in errors, as the sentence begins.

    Raises:
        KinfeasError: From every method, if the answer is malformed.
    """

    def __init__(self, hooks: Hooks, subject: str) -> None:
        self.hooks, self.answers = hooks, Answers(subject)
        package = package_of(hooks)
        self._on_reset, self._modify_command, self._on_step, self._modify_state = (
            PluginErrors(f"{subject} fails in {method}:", package)
            for method in ("on_reset", "modify_command", "on_step", "modify_state")
        )

    def on_reset(self, state: RobotState) -> dict[str, NDArray[Any]]:
        """Return what to remember from now on, arrays of leading axis n."""
        with self._on_reset:
            memory = self.hooks.on_reset(state)
        rows = len(state.base_pose)
        if not isinstance(memory, Mapping) or not all(
            isinstance(value, np.ndarray) and value.shape[:1] == (rows,)
            for value in memory.values()
        ):
            raise self.answers.error(
                f"must return a dict of arrays of leading axis {rows} from on_reset"
            )
        return memory

    def modify_command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, shape (n, 6), and the joint targets, (n, j), that are passed on."""
        try:
            answer = self.hooks.modify_command(twist, targets, dt)
        except BLAMED as error:
            self._modify_command.blame(error)
            raise
        if not isinstance(answer, tuple | list) or len(answer) != 2:
            raise self.answers.error(
                "must return a pair from modify_command: the twist and the joint targets"
            )
        self.answers.check_array(answer[0], "a twist", "modify_command", twist)
        self.answers.check_array(answer[1], "joint targets", "modify_command", targets)
        return answer[0], answer[1]

    def on_step(self, state: RobotState, dt: float) -> None:
        """Take note of what was measured after `dt` seconds."""
        try:
            self.hooks.on_step(state, dt)
        except BLAMED as error:
            self._on_step.blame(error)
            raise

    def modify_state(self, state: RobotState) -> RobotState:
        """Return what is seen of what was measured."""
        try:
            seen = self.hooks.modify_state(state)
        except BLAMED as error:
            self._modify_state.blame(error)
            raise
        if seen is not state:
            self.answers.check_state(seen, "modify_state", state.base_pose, state.joint_positions)
        return seen
