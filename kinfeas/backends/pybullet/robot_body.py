"""A robot as a PyBullet body: its joints, links, measurements and motors."""

import math

import numpy as np

from kinfeas.backends.physics.drives import ArmSetpoints, base_forces
from kinfeas.backends.physics.robot import PLANAR_JOINTS, moving_joints, physics_urdf
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.core.spatial import Array, planar_pose, relative, rotation, yaw
from kinfeas.robots.robot import Robot

_CYLINDER = b"unknown_file"  # file of the meshes that PyBullet makes of cylinders


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
        setpoints: Setpoints of the arm's joints, and of those that mimic them.
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
        resting = moving_joints(robot) & robot.fixed_joints.keys()
        self._rest = {self.joints[name]: robot.fixed_joints[name] for name in resting}
        self.setpoints = ArmSetpoints(robot, physics.config.arm_horizon)
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
        """Place the robot and its setpoints at rest: base pose (7,), arm joints (j,)."""
        self.setpoints.reset(joint_positions)
        planar = (*base_pose[:2].tolist(), float(yaw(base_pose)))
        arm = (self.joints[name] for name in self.setpoints.names)
        positions = dict(zip(self.base, planar, strict=True)) | self._rest
        positions |= zip(arm, self.setpoints.follow(joint_positions).tolist(), strict=True)
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

    def base_meshes(self) -> list[Array]:
        """Return the vertices of the base's collision meshes in its frame, (v, 3), metres."""
        client, meshes = self.physics.client, []
        base = planar_pose(*np.array(self.planar()))
        for link in sorted({*self.links.values()} - self.arm_links):
            frame = relative(self.physics.mass_pose(self.body, link), base)
            for number, shape in enumerate(client.getCollisionShapeData(self.body, link)):
                if shape[2] == client.GEOM_MESH and shape[4] != _CYLINDER:
                    vertices = np.array(client.getMeshData(self.body, link, number)[1])
                    meshes.append(rotation(frame).apply(vertices) + frame[:3])
        return meshes

    def measure(self) -> tuple[list[float], list[float]]:
        """Return positions and velocities of x, y, yaw and the arm's joints."""
        states = self.physics.client.getJointStates(self.body, [*self.base, *self.arm])
        return [state[0] for state in states], [state[1] for state in states]


class BaseDrive:
    """Velocity control of the planar joints within the platform's accelerations.

    A differential drive moves along its present heading.
    """

    def __init__(self, body: RobotBody) -> None:
        base = body.robot.base
        self._body, self._limits = body, base
        self._omnidirectional = base.drive == "omnidirectional"
        self._forces = base_forces(body.robot, body.physics.config, body.mass, body.yaw_inertia)
        self.reset()

    def reset(self) -> None:
        """Set all velocities to zero."""
        self._velocity = self._target = (0.0, 0.0)  # world x and y; forward and 0 if differential
        self._rotation = self._target_rotation = 0.0

    def command(self, twist: Array, dt: float) -> None:
        """Set the world twist, shape (6,), m/s and rad/s, for the next `dt` seconds.

        A differential drive follows the part of it along the heading at the end of the period, as
        in `kinfeas.kinematics.drive`.
        """
        x, y, self._target_rotation = float(twist[0]), float(twist[1]), float(twist[5])
        if not self._omnidirectional:
            heading = self._body.planar()[2] + self._target_rotation * dt
            x, y = math.cos(heading) * x + math.sin(heading) * y, 0.0
        self._target = (x, y)

    def drive(self) -> None:
        """Command the motors for one physics step."""
        client, time = self._body.physics.client, self._body.physics.step_time
        largest = self._limits.max_rotation_acceleration * time
        self._rotation += min(max(self._target_rotation - self._rotation, -largest), largest)
        self._velocity = self._accelerated(self._limits.max_acceleration * time)
        x, y = self._velocity
        if not self._omnidirectional:
            heading = self._body.planar()[2] + self._rotation * time
            x, y = math.cos(heading) * x, math.sin(heading) * x
        client.setJointMotorControlArray(
            self._body.body, self._body.base, client.VELOCITY_CONTROL,
            targetVelocities=[x, y, self._rotation], forces=self._forces,
        )  # fmt: skip

    def _accelerated(self, largest: float) -> tuple[float, float]:
        """Return the velocity, changed toward the target by at most `largest`, m/s."""
        x, y = self._target[0] - self._velocity[0], self._target[1] - self._velocity[1]
        change = math.hypot(x, y)
        if change <= largest:
            return self._target
        fraction = largest / change
        return self._velocity[0] + fraction * x, self._velocity[1] + fraction * y


class ArmDrive:
    """Position control of the arm's joints, and of those that mimic them, along `ArmSetpoints`.

    The motors have the URDF's limits of effort and velocity; at `counterbalanced` joints, springs
    carry the weight.

    Attributes:
        gain: Factor on the gains of the motors.
    """

    gain = 1.0

    def __init__(self, body: RobotBody) -> None:
        robot = body.robot
        self._body = body
        self._setpoints = setpoints = body.setpoints
        joints = [body.joints[name] for name in setpoints.names]
        self._motors = list(zip(joints, setpoints.effort, setpoints.velocity, strict=True))
        order = list(body.joints)
        sprung = [joint.name for joint in robot.arm if joint.name in robot.counterbalanced]
        self._sprung = [(body.joints[name], order.index(name)) for name in sprung]
        self._zeros = [0.0] * len(order)

    def command(self, targets: Array, steps: int) -> None:
        """Plan a path toward joint positions, shape (j,), for `steps` physics steps."""
        time: Array = self._body.physics.step_time * np.arange(1.0, steps + 1.0)
        path, _ = self._setpoints.plan(targets[np.newaxis], time)
        self._path = path[0].tolist()
        if self._sprung:
            load = self._body.physics.client.calculateInverseDynamics(
                self._body.body, self._body.positions(), self._zeros, self._zeros
            )
            self._load = [load[number] for _, number in self._sprung]

    def drive(self, step: int) -> None:
        """Command the motors for physics step number `step` since `command`."""
        client, body = self._body.physics.client, self._body.body
        # One by one: PyBullet's call for several joints ignores velocity limits.
        for (joint, effort, speed), position in zip(self._motors, self._path[step], strict=True):
            client.setJointMotorControl2(
                body, joint, client.POSITION_CONTROL, targetPosition=position,
                positionGain=self.gain, force=effort, maxVelocity=speed,
            )  # fmt: skip
        if self._sprung:
            joints = [joint for joint, _ in self._sprung]
            client.setJointMotorControlArray(body, joints, client.TORQUE_CONTROL, forces=self._load)
