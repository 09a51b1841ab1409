"""An adapter whose every answer is looked at: nothing malformed gets into a loop."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinfeas.core.backend import Backend, BackendWrapper, Resumable, RobotState
from kinfeas.core.checks.answers import Answers
from kinfeas.core.plugin_errors import PluginErrors, package_of
from kinfeas.core.spatial import Array

_METHODS = ("reset", "step", "close", "restore")
_PASSED_ON = ("seed", "grip", "obstacle_distances", "read", "stop", "snapshot")
"""What some backends can beside that, whose answers are not looked at."""


class CheckedAdapter(BackendWrapper):
    """An adapter that passes on another one's answers if they have the right form.

    It is for a class from outside that is a backend around a backend by itself, and can what that
    can. What the class raises becomes an error that names it and the line; so does what is raised
    beneath it and is no sentence yet.

    Args:
        adapter: Who answers.
        subject: What to call it in errors, as the sentence begins.
        backend: What the adapter is wrapped around.

    Attributes:
        adapter: Who answers.
        backend: What the adapter is wrapped around.

    Raises:
        KinfeasError: From every method, if the adapter fails or its answer is malformed.
    """

    def __init__(self, adapter: Backend, subject: str, backend: Backend) -> None:
        self.adapter, self.backend = adapter, backend
        self._answers, package = Answers(subject), package_of(adapter)
        self._plugin_errors = {
            method: PluginErrors(f"{subject} fails in {method}:", package)
            for method in (*_METHODS, *_PASSED_ON)
        }
        for method in _PASSED_ON:
            if callable(getattr(adapter, method, None)):
                setattr(self, method, partial(self._ask, method))
        if isinstance(adapter, Resumable):
            self.restore = self._restored
        # What robots there are: as many, with as many joints.
        self._base: Array = np.empty((0, 7))
        self._joints: Array = np.empty((0, 0))

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Begin new episodes and return what is seen of all n; shapes as in `Backend`."""
        if env_ids is None:
            self._base, self._joints = base_pose, joint_positions
        return self._look("reset", self._ask("reset", base_pose, joint_positions, env_ids))

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Pass on a command and return what is seen after it; shapes as in `Backend`."""
        return self._look("step", self._ask("step", base_twist, joint_targets, dt))

    def close(self) -> None:
        """Close the adapter, and so what it is wrapped around."""
        self._ask("close")

    def _restored(self, snapshot: Mapping[str, NDArray[Any]]) -> RobotState:
        """Take on a state that `snapshot` returned, of any number of robots."""
        state = self._ask("restore", snapshot)
        if isinstance(state, RobotState):
            self._base, self._joints = map(np.asarray, (state.base_pose, state.joint_positions))
        return self._look("restore", state)

    def _look(self, method: str, state: RobotState) -> RobotState:
        self._answers.check_state(state, method, self._base, self._joints)
        return state

    def _ask(self, method: str, *arguments: Any) -> Any:
        with self._plugin_errors[method]:
            return getattr(self.adapter, method)(*arguments)


def unchecked(backend: Backend) -> Backend:
    """Return the adapter or backend itself, to be asked of what class it is."""
    return backend.adapter if isinstance(backend, CheckedAdapter) else backend
