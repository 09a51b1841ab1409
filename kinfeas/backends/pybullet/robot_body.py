"""A robot as a PyBullet body: its joints, links and measurements."""

import numpy as np

from kinfeas.backends.physics.robot import (
    PLANAR_JOINTS,
    arm_followers,
    moving_joints,
    physics_urdf,
)
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.spatial import Array, planar_pose, yaw
from kinfeas.robots.robot import Robot


class RobotBody:
    """A robot on planar joints.

    Attributes:
        physics: Its world.
        robot: Robot model.
        body: PyBullet's number of the body.
        joints: Indices of the moving joints by name, in PyBullet's order.
        links: PyBullet's link index of each of the robot's links, by name; fixed links are merged.
        base: Indices of the planar joints x, y and yaw.
        arm: Indices of the arm's joints.
        arm_links: Indices of the links that the arm's joints carry.
        mass: Of the whole robot, kg.
        yaw_inertia: About the base's vertical axis, in the configuration `home`, kg m^2.
    """

    def __init__(self, physics: Physics, robot: Robot) -> None:
        """Load a robot at the origin in the configuration `home`."""
        self.physics, self.robot = physics, robot
        urdf, part_of = physics_urdf(robot)
        self.body = physics.load(robot.urdf_path, urdf, fixed=True)
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
        self._dynamics: dict[int, tuple[float, float, Array]] = {}
        above = frozenset().union(*(robot.urdf.below(joint.name) for joint in robot.arm))
        self.arm_links = frozenset(self.links[name] for name in above)
        client = physics.client
        for link in self.links.values():
            if link not in self.arm_links:  # the planar joints carry the base
                client.setCollisionFilterPair(self.body, physics.floor, link, -1, 0)
        self.reset(planar_pose(np.zeros(()), np.zeros(()), np.zeros(())), robot.home["home"])
        masses = (client.getDynamicsInfo(self.body, link)[0] for link in {*self.links.values()})
        self.mass = float(sum(masses))
        self.yaw_inertia = float(client.calculateMassMatrix(self.body, self.positions())[2][2])

    def reset(self, base_pose: Array, joint_positions: Array) -> None:
        """Place the robot at rest: base pose (7,), arm joints (j,)."""
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

    def note_dynamics(self) -> None:
        """Note masses, inertias and frictions of the links, which `scale` multiplies."""
        for link in {*self.links.values()}:
            mass, friction, inertia = self.physics.client.getDynamicsInfo(self.body, link)[:3]
            self._dynamics[link] = mass, friction, np.array(inertia)

    def scale(self, mass: float, friction: float) -> None:
        """Multiply the noted masses and frictions of all links."""
        for link, (own_mass, own_friction, inertia) in self._dynamics.items():
            self.physics.client.changeDynamics(
                self.body, link, mass=mass * own_mass, localInertiaDiagonal=mass * inertia,
                lateralFriction=friction * own_friction,
            )  # fmt: skip

    def positions(self) -> list[float]:
        """Return the positions of all moving joints, in PyBullet's order."""
        return [state[0] for state in self.physics.client.getJointStates(self.body, self._order)]

    def planar(self) -> tuple[float, float, float]:
        """Return x, y and yaw of the base, metres and radians; the yaw is not wrapped."""
        x, y, heading = self.physics.client.getJointStates(self.body, self.base)
        return x[0], y[0], heading[0]

    def measure(self) -> tuple[list[float], list[float]]:
        """Return positions and velocities of x, y, yaw and the arm's joints."""
        states = self.physics.client.getJointStates(self.body, [*self.base, *self.arm])
        return [state[0] for state in states], [state[1] for state in states]
