"""A robot as a body of the PyBullet world: where its joints are and what they measure."""

import numpy as np

from kinfeas.backends.pybullet.moving_joints import arm_followers, moving_joints
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.backends.pybullet.robot_urdf import PLANAR_JOINTS, physics_urdf
from kinfeas.core.backend import RobotState
from kinfeas.core.spatial import Array, planar_pose, wrap, yaw
from kinfeas.robots.robot import Robot


class RobotBody:
    """A robot that stands on planar joints.

    Attributes:
        physics: World that it is in.
        robot: What is known of it.
        body: PyBullet's number of it.
        joints: Indices of the joints that move, by name, in PyBullet's order.
        links: By the name of each of the robot's links the index of what it is a part of.
        base: Indices of the planar joints x, y and yaw.
        arm: Indices of the arm's joints.
        arm_links: Indices of the links that the arm's joints carry.
        mass: All of it, kg.
        yaw_inertia: About the base's vertical axis, in the configuration `home`, kg m^2.
    """

    def __init__(self, physics: Physics, robot: Robot) -> None:
        """Put a robot into the world, at the origin and in the configuration `home`."""
        self.physics, self.robot = physics, robot
        urdf, part_of = physics_urdf(robot)
        self.body = physics.load_text(urdf, robot.urdf_path)
        self.joints, links = physics.joints(self.body), physics.links(self.body)
        self.links = {name: links[of] for name, of in part_of.items()}
        self.base = [self.joints[name] for name in PLANAR_JOINTS]
        self.arm = [self.joints[joint.name] for joint in robot.arm]
        self._order = list(self.joints.values())
        self._rest = {
            self.joints[name]: robot.fixed_joints[name]
            for name in moving_joints(robot)
            if name in robot.fixed_joints
        }
        self._followers = arm_followers(robot)
        above = frozenset().union(*(robot.urdf.below(joint.name) for joint in robot.arm))
        self.arm_links = frozenset(self.links[name] for name in above)
        self._pass_through_the_floor()
        home = robot.home["home"]
        self.reset(planar_pose(np.zeros(()), np.zeros(()), np.zeros(())), home)
        client = physics.client
        masses = (client.getDynamicsInfo(self.body, link)[0] for link in {*self.links.values()})
        self.mass = float(sum(masses))
        inertia = client.calculateMassMatrix(self.body, self.positions())
        self.yaw_inertia = float(inertia[2][2])

    def reset(self, base_pose: Array, joint_positions: Array) -> None:
        """Put the robot at rest somewhere: pose of shape (7,), arm joints of shape (j,)."""
        planar = (*base_pose[:2].tolist(), float(yaw(base_pose)))
        arm = dict(zip((joint.name for joint in self.robot.arm), joint_positions, strict=True))
        follow = {
            self.joints[one.name]: one.multiplier * arm[one.leader] + one.offset
            for one in self._followers
        }
        positions = dict(zip(self.base, planar, strict=True)) | self._rest | follow
        positions |= dict(zip(self.arm, joint_positions.tolist(), strict=True))
        for index, position in positions.items():
            self.physics.client.resetJointState(self.body, index, position, 0.0)

    def positions(self) -> list[float]:
        """Return the positions of all joints that move, in PyBullet's order."""
        return [state[0] for state in self.physics.client.getJointStates(self.body, self._order)]

    def planar(self) -> tuple[float, float, float]:
        """Return x, y and yaw of the base, metres and radians; the yaw is not wrapped."""
        x, y, heading = self.physics.client.getJointStates(self.body, self.base)
        return x[0], y[0], heading[0]

    def measure(self) -> tuple[list[float], list[float]]:
        """Return positions and velocities of x, y, yaw and the arm's joints."""
        states = self.physics.client.getJointStates(self.body, [*self.base, *self.arm])
        return [state[0] for state in states], [state[1] for state in states]

    def state(self) -> RobotState:
        """Return what was measured, as a batch of one."""
        positions, velocities = self.measure()
        return robot_state(self.robot, np.array([positions]), np.array([velocities]))

    def _pass_through_the_floor(self) -> None:
        """Leave contacts of the base with the floor out: planar joints bear it already."""
        for link in self.links.values():
            if link not in self.arm_links:
                self.physics.client.setCollisionFilterPair(
                    self.body, self.physics.floor, link, -1, 0
                )


def robot_state(robot: Robot, positions: Array, velocities: Array) -> RobotState:
    """Return the state of n robots; continuous joints are in (-pi, pi].

    Args:
        robot: Robot that was measured.
        positions: x, y, yaw and arm joints, shape (n, 3 + j), metres and radians.
        velocities: Of the same, per second.
    """
    twist = np.zeros((len(positions), 6))
    twist[:, [0, 1, 5]] = velocities[:, :3]
    joints = positions[:, 3:]
    return RobotState(
        base_pose=planar_pose(*positions[:, :3].T),
        joint_positions=np.where(robot.continuous, wrap(joints), joints),
        base_twist=twist,
        joint_velocities=velocities[:, 3:],
    )
