"""What the backend of a robot answers, looked at: nothing malformed gets into a loop."""

from typing import Any

import numpy as np

from kinfeas.core.backend import Backend, RobotState
from kinfeas.core.checks.answers import Answers
from kinfeas.core.spatial import Array


class BackendAnswers:
    """Looks at what the backend of one robot answers.

    Numbers need not be finite: whether a measurement can be believed is another question.

    Args:
        backend: Who answers.
        joints: How many joints the arm has.
    """

    def __init__(self, backend: Backend, joints: int) -> None:
        self._answers = Answers(f"backend {type(backend).__name__}")
        self._base, self._joints = _like(1, 7), _like(1, joints)
        self._others = (  # what a state need not say
            ("age", "an age", _like(1)),
            ("base_twist", "a base_twist", _like(1, 6)),
            ("joint_velocities", "joint_velocities", _like(1, joints)),
        )

    def state(self, answer: Any, method: str) -> RobotState:
        """Return an answer, if it is the state of one robot.

        Args:
            answer: What the backend says.
            method: Where it does.

        Raises:
            KinfeasError: If it is anything else; the sentence names the backend.
        """
        self._answers.check_state(answer, method, self._base, self._joints)
        for name, what, like in self._others:
            value = getattr(answer, name)
            if value is not None:
                self._answers.check_array(value, what, method, like)
        state: RobotState = answer
        return state


def _like(*shape: int) -> Array:
    """Return what answers must be alike: an array that is not finite, so that they need not be."""
    return np.full(shape, np.nan)
