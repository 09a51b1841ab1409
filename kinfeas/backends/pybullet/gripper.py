"""The gripper of a robot in the PyBullet world: it opens, closes and feels what it touches."""

from kinfeas.backends.pybullet.moving_joints import finger_followers
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.errors import KinfeasError

_RELAXED = 0.1  # of a finger's effort
_COUPLING = 0.5  # of a finger's effort: less than that, so that both close round what is aside


class GripperDrive:
    """Two fingers that move alike, until something is in the way of one of them.

    Attributes:
        fingers: Indices of the links of each finger.
    """

    def __init__(self, body: RobotBody) -> None:
        """Connect to the fingers of a robot, which stay where they are.

        Raises:
            KinfeasError: If the robot's YAML file says nothing of a gripper.
        """
        robot = body.robot
        if robot.gripper is None:
            raise KinfeasError(
                f"robot {robot.name!r} has no gripper: its YAML file lacks 'gripper'"
            )
        self._body, self._gripper = body, robot.gripper
        self._followers = finger_followers(robot)
        self.fingers = tuple(
            frozenset(body.links[link] for link in robot.urdf.below(finger))
            for finger in robot.gripper.fingers
        )
        self._rub()
        self._gear = self._couple()
        self.reset()

    @property
    def opening(self) -> float:
        """How far the fingers are open now, from 0 to 1."""
        joints = [self._body.joints[name] for name in self._gripper.fingers]
        states = self._body.physics.client.getJointStates(self._body.body, joints)
        mean = sum(state[0] for state in states) / len(states)
        return (mean - self._gripper.closed) / (self._gripper.open - self._gripper.closed)

    def reset(self) -> None:
        """Hold the fingers where `fixed_joints` puts them, as at the beginning."""
        fixed = self._body.robot.fixed_joints
        self._targets = {name: fixed[name] for name in self._gripper.fingers}
        self._exert(self._gripper.effort)

    def open(self) -> None:
        """Begin to open, all the way."""
        self._move(self._gripper.open)

    def close(self) -> None:
        """Begin to close until something is in the way."""
        self._move(self._gripper.closed)

    def relax(self) -> None:
        """Leave each finger where it is now, with little effort."""
        client, joints = self._body.physics.client, self._body.joints
        for name in self._gripper.fingers:
            self._targets[name] = client.getJointState(self._body.body, joints[name])[0]
        self._exert(_RELAXED * self._gripper.effort)

    def drive(self) -> None:
        """Command the motors that follow others, for one physics step."""
        client, body = self._body.physics.client, self._body
        for one in self._followers:
            leader = client.getJointState(body.body, body.joints[one.leader])[0]
            self._motor(one.name, one.multiplier * leader + one.offset)

    def touching(self, body: int, link: int) -> frozenset[int]:
        """Return which fingers, 0 and 1, touch a link of a body."""
        physics = self._body.physics
        points = physics.client.getClosestPoints(
            self._body.body, body, physics.config.finger_softness
        )
        touched = {point[3] for point in points if link == point[4]}
        return frozenset(i for i, links in enumerate(self.fingers) if links & touched)

    def _move(self, position: float) -> None:
        self._targets = dict.fromkeys(self._gripper.fingers, position)
        self._exert(self._gripper.effort)

    def _motor(self, name: str, position: float) -> None:
        client = self._body.physics.client
        client.setJointMotorControl2(
            self._body.body,
            self._body.joints[name],
            client.POSITION_CONTROL,
            targetPosition=position,
            positionGain=1.0,
            force=self._effort,
            maxVelocity=self._body.robot.urdf.joints[name].velocity,
        )

    def _rub(self) -> None:
        physics = self._body.physics
        for link in frozenset().union(*self.fingers):
            physics.client.changeDynamics(
                self._body.body, link, lateralFriction=physics.config.finger_friction
            )

    def retime(self) -> None:
        """Follow a change of the physics step, for which PyBullet keeps impulses, not forces."""
        self._exert(self._effort)

    def _exert(self, effort: float) -> None:
        self._effort = effort
        self._body.physics.client.changeConstraint(
            self._gear, gearRatio=-1.0, maxForce=_COUPLING * effort
        )
        for name, target in self._targets.items():
            self._motor(name, target)

    def _couple(self) -> int:
        """Return what keeps one finger as far open as the other, so that both do not give way."""
        client, joints = self._body.physics.client, self._body.joints
        ends = [
            value for name in self._gripper.fingers for value in (self._body.body, joints[name])
        ]
        gear: int = client.createConstraint(
            *ends, client.JOINT_GEAR, [1.0, 0.0, 0.0], [0.0] * 3, [0.0] * 3
        )
        return gear
