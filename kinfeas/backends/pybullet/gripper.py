"""The gripper and what it holds."""

import numpy as np

from kinfeas.backends.physics.robot import finger_followers
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.control.execution import tool_pose
from kinfeas.core.backend import Grip
from kinfeas.core.spatial import IDENTITY, Array, compose, relative
from kinfeas.robots.spec import GripperSpec

_RELAXED = 0.1  # effort while holding, as a fraction of a finger's effort
_COUPLING = 0.5  # of a finger's effort: below 1, so that both close round an object off centre
_PAD = 0.03  # m, distance from the tip at which the fingers hold an object that cannot turn
_CENTRE = IDENTITY[np.newaxis]
# Points of a rigid grasp, in the plane of the pads, whose normal is the finger axis y.
_PADS = np.repeat(_CENTRE, 4, axis=0)
_PADS[:, [0, 2]] = _PAD * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


class GripperDrive:
    """Two fingers that open equally far until one of them is blocked.

    Attributes:
        fingers: Indices of the links of each finger.
    """

    def __init__(self, body: RobotBody, gripper: GripperSpec) -> None:
        robot = body.robot
        self._body, self._gripper = body, gripper
        self._followers = finger_followers(robot)
        self.fingers = tuple(
            frozenset(body.links[link] for link in robot.urdf.below(finger))
            for finger in gripper.fingers
        )
        client, config = body.physics.client, body.physics.config
        for link in frozenset().union(*self.fingers):
            client.changeDynamics(body.body, link, lateralFriction=config.finger_friction)
        # A gear keeps both fingers equally far open.
        joints = [(body.body, body.joints[name]) for name in gripper.fingers]
        self._gear: int = client.createConstraint(
            *joints[0], *joints[1], client.JOINT_GEAR, [1.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3
        )
        self.reset()

    def reset(self) -> None:
        """Hold the fingers at the robot's `fixed_joints`."""
        fixed = self._body.robot.fixed_joints
        self._targets = {name: fixed[name] for name in self._gripper.fingers}
        self._exert(self._gripper.effort)

    def move(self, grip: Grip) -> None:
        """Start to close or to open."""
        self._targets = self._gripper.positions(grip)
        self._exert(self._gripper.effort)

    def relax(self) -> None:
        """Hold each finger where it is, with little effort."""
        client, joints = self._body.physics.client, self._body.joints
        for name in self._gripper.fingers:
            self._targets[name] = client.getJointState(self._body.body, joints[name])[0]
        self._exert(_RELAXED * self._gripper.effort)

    def drive(self) -> None:
        """Command the mimicking joints for one physics step."""
        client, body = self._body.physics.client, self._body
        for mimic in self._followers:
            leader = client.getJointState(body.body, body.joints[mimic.leader])[0]
            self._motor(mimic.name, mimic.multiplier * leader + mimic.offset)

    def touching(self, body: int, link: int) -> frozenset[int]:
        """Return which fingers, 0 and 1, touch a link of a body."""
        physics = self._body.physics
        points = physics.client.getClosestPoints(
            self._body.body, body, physics.config.finger_softness
        )
        touched = {point[3] for point in points if link == point[4]}
        return frozenset(i for i, links in enumerate(self.fingers) if links & touched)

    def apply_step_time(self) -> None:
        """Command the motors again: PyBullet keeps impulses, which depend on the step time."""
        self._exert(self._effort)

    def _exert(self, effort: float) -> None:
        self._effort = effort
        self._body.physics.client.changeConstraint(
            self._gear, gearRatio=-1.0 / self._gripper.ratio, maxForce=_COUPLING * effort
        )
        for name, target in self._targets.items():
            self._motor(name, target)

    def _motor(self, name: str, position: float) -> None:
        client = self._body.physics.client
        client.setJointMotorControl2(
            self._body.body, self._body.joints[name], client.POSITION_CONTROL,
            targetPosition=position, positionGain=1.0, force=self._effort,
            maxVelocity=self._body.robot.finger_velocity(name),
        )  # fmt: skip


class Grasp:
    """A spring and damper between the hand and at most one link of one body.

    It models the friction of soft fingers: it forms only where both fingers touch, and breaks
    above `grasp_limit`. Its compliance is that of real fingers and arms. With rigid motors and a
    rigid grasp, the force at a closed door would be unbounded.

    Attributes:
        gripper: The fingers.
        held: Numbers of body and link; None for nothing.
        force: Size of its force in the last physics step, N.
    """

    def __init__(self, body: RobotBody, gripper: GripperDrive) -> None:
        self._physics, self.gripper = body.physics, gripper
        self._hand = (body.body, body.links[body.robot.ee_frame])
        self._tip = tool_pose(body.robot)
        self._ends: list[tuple[tuple[int, int], Array]] = []
        self.held: tuple[int, int] | None = None
        self.force = 0.0

    def hold(self, body: int, link: int, *, rigid: bool = True) -> bool:
        """Hold a link if both fingers touch it, and return whether they do.

        If not `rigid`, the link can turn in the hand.
        """
        if self.gripper.touching(body, link) != {0, 1}:
            return False
        self.held = (body, link)
        tip = compose(self._physics.link_pose(*self._hand), self._tip)
        points = compose(tip, _PADS if rigid else _CENTRE)
        ends, mass_pose = (self._hand, self.held), self._physics.mass_pose
        self._ends = [(end, relative(points, mass_pose(*end))) for end in ends]
        # If both fingers kept squeezing, the difference of their forces would load the grasp.
        self.gripper.relax()
        return True

    def drive(self) -> None:
        """Apply the grasp's forces for one physics step."""
        if self.held is None:
            return
        config, client = self._physics.config, self._physics.client
        (hand, hand_velocity), (link, link_velocity) = (self._motion(*end) for end in self._ends)
        fraction = 1.0 / len(hand)
        forces = config.grasp_stiffness * fraction * (hand - link)
        forces += config.grasp_damping * fraction * (hand_velocity - link_velocity)
        self.force = float(np.linalg.norm(forces.sum(axis=0)))
        for on_hand, on_link, force in zip(hand, link, forces, strict=True):
            for end, point, pull in ((self._hand, on_hand, -force), (self.held, on_link, force)):
                client.applyExternalForce(*end, pull.tolist(), point.tolist(), client.WORLD_FRAME)

    def release(self) -> None:
        """Hold nothing."""
        self._ends, self.held, self.force = [], None, 0.0

    def _motion(self, end: tuple[int, int], points: Array) -> tuple[Array, Array]:
        """Return world positions and velocities of points, poses (k, 7) in an inertial frame."""
        pose, linear, (x, y, z) = self._physics.motion(*end)
        positions = compose(pose, points)[:, :3]
        # Cross product as a matrix: numpy's function takes ten times as long.
        cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        return positions, linear + (positions - pose[:3]) @ cross
