"""What the answers of an adapter from outside must be: sentences on those that are not."""

from typing import Any

import numpy as np

from kinfeas.core.backend import RobotState
from kinfeas.core.checks.arrays import instead, sound
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array


class Answers:
    """Looks at what one adapter answers.

    Numbers must be finite where those are that they are compared with.

    Args:
        subject: What to call it in errors, as the sentence begins.

    Raises:
        KinfeasError: From `check_state` and `check_array`, if an answer is malformed.
    """

    def __init__(self, subject: str) -> None:
        self.subject = subject

    def check_state(self, answer: Any, method: str, base: Array, joints: Array) -> None:
        """Do nothing if an answer is a state of robots.

        Args:
            answer: What the adapter says of them.
            method: Where it does.
            base: A base_pose of these robots, shape (n, 7).
            joints: Their joint_positions, shape (n, j).
        """
        self._check_poses(answer, "", method, base, joints)
        if answer.true_state is not None:
            self._check_poses(answer.true_state, " as true_state", method, base, joints)

    def check_array(self, answer: Any, what: str, method: str, given: Array) -> None:
        """Do nothing if an answer is an array of the form of `given`."""
        if sound(answer, given.shape):
            return
        if got := instead(answer, given.shape):
            raise self.error(f"must return {what} of shape {given.shape} from {method}, not {got}")
        if not np.isfinite(answer).all() and np.isfinite(given).all():
            raise self.error(f"returns {what} from {method} with numbers that are not finite")

    def _check_poses(self, state: Any, told: str, method: str, base: Array, joints: Array) -> None:
        if not isinstance(state, RobotState):
            got = type(state).__name__
            raise self.error(f"must return a RobotState{told} from {method}, not {got}")
        self.check_array(state.base_pose, f"a base_pose{told}", method, base)
        self.check_array(state.joint_positions, f"joint_positions{told}", method, joints)
        if state.ee_in_base is not None:
            self.check_array(state.ee_in_base, f"an ee_in_base{told}", method, base)

    def error(self, broken: str) -> KinfeasError:
        """Return an error with the sentence `broken`, which has the adapter as its subject."""
        return KinfeasError(f"{self.subject} {broken}")
