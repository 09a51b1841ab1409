"""The hooks of an adapter whose every answer is looked at: nothing malformed gets to a robot."""

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kinfeas.backend import RobotState
from kinfeas.errors import KinfeasError
from kinfeas.foreign import USUAL, Blaming, package_of
from kinfeas.spatial import Array


class Hooks(Protocol):
    """What a subclass of `Adapter` overrides."""

    def begin(self, state: RobotState) -> dict[str, NDArray[Any]]:
        """Return what to remember from now on."""
        ...

    def command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist and the joint targets that are passed on."""
        ...

    def advance(self, state: RobotState, dt: float) -> None:
        """Take note of what was measured."""
        ...

    def view(self, state: RobotState) -> RobotState:
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
        self.hooks, self.subject = hooks, subject
        package = package_of(hooks)
        self._begin, self._command, self._advance, self._view = (
            Blaming(f"{subject} fails in {method}:", package)
            for method in ("begin", "command", "advance", "view")
        )

    def begin(self, state: RobotState) -> dict[str, NDArray[Any]]:
        """Return what to remember from now on, arrays of leading axis n."""
        with self._begin:
            memory = self.hooks.begin(state)
        rows = len(state.base_pose)
        if not isinstance(memory, Mapping) or not all(
            isinstance(value, np.ndarray) and value.shape[:1] == (rows,)
            for value in memory.values()
        ):
            raise self._error(f"must return a dict of arrays of leading axis {rows} from begin")
        return memory

    def command(self, twist: Array, targets: Array, dt: float) -> tuple[Array, Array]:
        """Return the twist, shape (n, 6), and the joint targets, (n, j), that are passed on."""
        try:
            answer = self.hooks.command(twist, targets, dt)
        except USUAL as error:
            self._command.blame(error)
            raise
        if not isinstance(answer, tuple | list) or len(answer) != 2:
            raise self._error("must return a pair from command: the twist and the joint targets")
        self._require("a twist", "command", answer[0], twist)
        self._require("joint targets", "command", answer[1], targets)
        return answer[0], answer[1]

    def advance(self, state: RobotState, dt: float) -> None:
        """Take note of what was measured after `dt` seconds."""
        try:
            self.hooks.advance(state, dt)
        except USUAL as error:
            self._advance.blame(error)
            raise

    def view(self, state: RobotState) -> RobotState:
        """Return what is seen of what was measured."""
        try:
            seen = self.hooks.view(state)
        except USUAL as error:
            self._view.blame(error)
            raise
        if seen is state:
            return seen
        if not isinstance(seen, RobotState):
            raise self._error(f"must return a RobotState from view, not {type(seen).__name__}")
        self._require("a base_pose", "view", seen.base_pose, state.base_pose)
        self._require("joint_positions", "view", seen.joint_positions, state.joint_positions)
        if seen.ee_in_base is not None:
            self._require("an ee_in_base", "view", seen.ee_in_base, state.base_pose)
        return seen

    def _require(self, what: str, method: str, value: Any, given: Array) -> None:
        """Raise unless an array is of the form of the one that the hook was given."""
        if type(value) is np.ndarray and value.shape == given.shape and value.dtype == np.float64:
            # One product looks at all numbers at once; what overflows is looked at again.
            if math.isfinite(np.vdot(value, value)):
                return
        elif not isinstance(value, np.ndarray) or value.shape != given.shape:
            got = getattr(value, "shape", type(value).__name__)
            raise self._error(f"must return {what} of shape {given.shape} from {method}, not {got}")
        elif value.dtype.kind not in "biuf":
            raise self._error(f"must return {what} of numbers from {method}, not {value.dtype}")
        if not np.isfinite(value).all() and np.isfinite(given).all():
            raise self._error(f"returns {what} from {method} with numbers that are not finite")

    def _error(self, broken: str) -> KinfeasError:
        return KinfeasError(f"{self.subject} {broken}")
