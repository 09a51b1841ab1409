"""What the answers of an adapter from outside must be: sentences on those that are not."""

import math
from typing import Any

import numpy as np

from kinfeas.backend import RobotState
from kinfeas.errors import KinfeasError
from kinfeas.spatial import Array


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
        if answer.truth is not None:
            self._check_poses(answer.truth, " as truth", method, base, joints)

    def check_array(self, answer: Any, what: str, method: str, given: Array) -> None:
        """Do nothing if an answer is an array of the form of `given`."""
        if (
            type(answer) is np.ndarray
            and answer.shape == given.shape
            and answer.dtype == np.float64
        ):
            # One product looks at all numbers at once; what overflows is looked at again.
            if math.isfinite(np.vdot(answer, answer)):
                return
        elif not isinstance(answer, np.ndarray) or answer.shape != given.shape:
            got = getattr(answer, "shape", type(answer).__name__)
            raise self.error(f"must return {what} of shape {given.shape} from {method}, not {got}")
        elif answer.dtype.kind not in "biuf":
            raise self.error(f"must return {what} of numbers from {method}, not {answer.dtype}")
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
