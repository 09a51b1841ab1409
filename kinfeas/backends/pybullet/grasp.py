"""A grasp: what the two fingers touch moves with the hand until something pulls harder."""

import numpy as np

from kinfeas.backends.pybullet.gripper import GripperDrive
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.control.subgoals import tool_pose
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import IDENTITY, Array, compose, relative

_PAD = 0.03  # m, how far from the tip the fingers hold what cannot turn
_CENTRE = IDENTITY[np.newaxis]
# In the plane of the pads, whose normal is the finger axis.
_PADS = np.repeat(_CENTRE, 4, axis=0)
_PADS[:, [0, 2]] = _PAD * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


class Grasp:
    """Holds one link of one body at a time.

    It stands for the friction of soft fingers, which a simulation of boxes lacks: it forms only
    where both fingers touch, and it breaks above a force. It gives way like fingers and arm of a
    real robot: the simulated motors do not, and a rigid grasp between them and a door that is shut
    would have to bear any force.

    Attributes:
        held: Numbers of body and link in the hand; None for nothing.
        force: What the grasp exerted in the last physics step, N.
    """

    def __init__(self, body: RobotBody, gripper: GripperDrive) -> None:
        """Make a hand that holds nothing."""
        self._physics, self._gripper = body.physics, gripper
        self._hand = (body.body, body.links[body.robot.ee_frame])
        self._tip = tool_pose(body.robot)
        self._ends: list[tuple[tuple[int, int], Array]] = []
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
        self.held = (body, link)
        tip = compose(self._physics.link_pose(*self._hand), self._tip)
        points = compose(tip, _PADS if rigid else _CENTRE)
        self._ends = [(end, self._within(end, points)) for end in (self._hand, self.held)]
        # Fingers that squeeze on, one a little more than the other, would pull at the grasp.
        self._gripper.relax()
        return True

    def drive(self) -> None:
        """Pull hand and link together for one physics step."""
        if self.held is None:
            return
        config, client = self._physics.config, self._physics.client
        (hand, hand_speed), (link, link_speed) = (self._motion(*end) for end in self._ends)
        share = 1.0 / len(hand)
        forces = config.grasp_stiffness * share * (hand - link)
        forces += config.grasp_damping * share * (hand_speed - link_speed)
        self.force = float(np.linalg.norm(forces.sum(axis=0)))
        for point_in_hand, point, force in zip(hand, link, forces, strict=True):
            for end, at, pull in ((self._hand, point_in_hand, -force), (self.held, point, force)):
                client.applyExternalForce(*end, pull.tolist(), at.tolist(), client.WORLD_FRAME)

    def update(self) -> None:
        """Let go if the force is above the limit at the end of a control period."""
        if self.force > self._physics.config.grasp_limit:
            self.release()

    def release(self) -> None:
        """Let go of what is held, if anything is."""
        self._ends, self.held, self.force = [], None, 0.0

    def _within(self, end: tuple[int, int], points: Array) -> Array:
        """Return poses (k, 7) of the world as poses in the frame of a link's inertia."""
        return relative(points, self._physics.mass_pose(*end))

    def _motion(self, end: tuple[int, int], points: Array) -> tuple[Array, Array]:
        """Return where points of a link, poses (k, 7), are in the world and how they move."""
        pose, linear, (x, y, z) = self._physics.motion(*end)
        there = compose(pose, points)[:, :3]
        # What a lever, times it, moves at: numpy's cross product takes ten times as long.
        turning = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        return there, linear + (there - pose[:3]) @ turning
