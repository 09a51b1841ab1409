"""A grasp: what the two fingers touch moves with the hand until something pulls harder."""

import numpy as np

from kinfeas.errors import KinfeasError
from kinfeas.sim.gripper import GripperDrive
from kinfeas.sim.robot_body import RobotBody
from kinfeas.spatial import IDENTITY, Array, compose, relative

_STIFFER = 10.0  # times the limit is what the constraint may exert, so that it is seen to exceed it


class Grasp:
    """Holds one link of one body at a time.

    It stands for the friction of soft fingers, which a simulation of boxes lacks: it forms only
    where both fingers touch, and it breaks above a force.

    Attributes:
        held: Numbers of body and link in the hand; None for nothing.
        force: What the grasp exerted in the last control period, N.
    """

    def __init__(self, body: RobotBody, gripper: GripperDrive) -> None:
        """Make a hand that holds nothing."""
        self._body, self._gripper = body, gripper
        self._link = body.links[body.robot.ee_frame]
        self._tip = np.concatenate([body.robot.tool_tip, IDENTITY[3:]])
        self._limit = body.physics.config.grasp_limit
        self._constraint: int | None = None
        self.held: tuple[int, int] | None = None
        self.force = 0.0

    def hold(self, body: int, link: int, *, rigid: bool = True) -> bool:
        """Take hold of a link and return whether both fingers touch it, as they must.

        Args:
            body: PyBullet's number of the body.
            link: Index of the link in it.
            rigid: Whether the link cannot turn in the hand either, as a handle that is a bar can.

        Raises:
            KinfeasError: If the hand holds something already.
        """
        if self.held is not None:
            raise KinfeasError("the gripper holds something already, release it first")
        if self._gripper.touching(body, link) != {0, 1}:
            return False
        physics, client = self._body.physics, self._body.physics.client
        # PyBullet gives frames of constraints in those of the links' inertia.
        tip = compose(physics.link_pose(self._body.body, self._link), self._tip)
        parent = relative(tip, physics.mass_pose(self._body.body, self._link))
        child = relative(tip, physics.mass_pose(body, link))
        kind = client.JOINT_FIXED if rigid else client.JOINT_POINT2POINT
        constraint = client.createConstraint(
            self._body.body, self._link, body, link, kind, [0.0] * 3, *_frames(parent, child)
        )
        self._constraint, self.held = constraint, (body, link)
        self.retime()
        # Fingers that squeeze on, one a little more than the other, would pull at the grasp.
        self._gripper.relax()
        return True

    def retime(self) -> None:
        """Follow a change of the physics step, for which PyBullet keeps impulses, not forces."""
        if self._constraint is not None:
            self._body.physics.client.changeConstraint(
                self._constraint, maxForce=_STIFFER * self._limit
            )

    def update(self) -> None:
        """Measure the force after a control period and let go if it is above the limit."""
        if self._constraint is None:
            return
        forces = self._body.physics.client.getConstraintState(self._constraint)
        self.force = float(np.linalg.norm(forces[:3]))
        if self.force > self._limit:
            self.release()

    def release(self) -> None:
        """Let go of what is held, if anything is."""
        if self._constraint is not None:
            self._body.physics.client.removeConstraint(self._constraint)
        self._constraint, self.held, self.force = None, None, 0.0


def _frames(parent: Array, child: Array) -> tuple[list[float], ...]:
    return parent[:3].tolist(), child[:3].tolist(), parent[3:].tolist(), child[3:].tolist()
