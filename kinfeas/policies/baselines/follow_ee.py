"""The base copies the planar velocity of the EE's motion, without rotation of its own."""

from dataclasses import dataclass

from kinfeas.control.drive import action_toward
from kinfeas.control.observation import HORIZON
from kinfeas.core.policy import PolicyInput
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Base


@dataclass(frozen=True)
class FollowEe:
    """Drives as the EE is to move.

    It acts on the motion planned for `HORIZON` seconds, whatever the control period: the velocity
    is the mean of that time, and a differential base that is asked more often takes a part of the
    turn each time.

    Attributes:
        base: Drive and velocity limits.
        feedback: Whether the velocity is measured from the achieved EE position, so that the base
            also closes the arm's error, or from the desired one.
    """

    base: Base
    feedback: bool = False

    def act(self, policy_input: PolicyInput) -> Array:
        """Return base commands in [-1, 1], shape (n, 3) or (n, 2)."""
        start = policy_input.ee_pose if self.feedback else policy_input.desired
        velocity = (policy_input.planned[:, :2] - start[:, :2]) / HORIZON
        return action_toward(self.base, policy_input.base_pose, velocity, HORIZON)
