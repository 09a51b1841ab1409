"""Motors of the base and of the arm."""

import math

import numpy as np

from kinfeas.backends.physics.drives import ArmSetpoints, base_forces
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.spatial import Array


class BaseDrive:
    """Velocity control of the planar joints within the platform's accelerations.

    A differential drive moves along its present heading.
    """

    def __init__(self, body: RobotBody) -> None:
        """Connect to the planar joints of a robot at rest."""
        base = body.robot.base
        self._body, self._limits = body, base
        self._omnidirectional = base.drive == "omnidirectional"
        self._forces = base_forces(body.robot, body.physics.config, body.mass, body.yaw_inertia)
        self.reset()

    def reset(self) -> None:
        """Set all velocities to zero."""
        self._velocity = self._target = (0.0, 0.0)  # world x and y, or along the heading and 0
        self._rotation = self._target_rotation = 0.0

    def command(self, twist: Array, dt: float) -> None:
        """Set the world twist, shape (6,), m/s and rad/s, for the next `dt` seconds.

        A differential drive follows the part of it along the heading at the end of the period, as
        in `kinfeas.kinematics.drive`.
        """
        x, y, self._target_rotation = float(twist[0]), float(twist[1]), float(twist[5])
        if not self._omnidirectional:
            heading = self._heading() + self._target_rotation * dt
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
            heading = self._heading() + self._rotation * time
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
        share = largest / change
        return self._velocity[0] + share * x, self._velocity[1] + share * y

    def _heading(self) -> float:
        return self._body.planar()[2]


class ArmDrive:
    """Position control of the arm's joints, and of those that mimic them, along `ArmSetpoints`.

    The motors have the URDF's effort and velocity; `counterbalanced` joints have springs.

    Attributes:
        gain: Factor on the gains of the motors.
    """

    gain = 1.0

    def __init__(self, body: RobotBody) -> None:
        """Connect to the arm of a robot; call `reset` next."""
        robot = body.robot
        self._body = body
        self._setpoints = ArmSetpoints(robot, body.physics.config.arm_horizon)
        moved = self._setpoints
        self._motors = [
            (body.joints[name], effort, speed)
            for name, effort, speed in zip(moved.names, moved.effort, moved.velocity, strict=True)
        ]
        order = list(body.joints)
        sprung = [joint.name for joint in robot.arm if joint.name in robot.counterbalanced]
        self._sprung = [(body.joints[name], order.index(name)) for name in sprung]
        self._zeros = [0.0] * len(order)

    def reset(self, joint_positions: Array) -> None:
        """Start at rest at joint positions, shape (j,)."""
        self._setpoints.reset(joint_positions)

    def command(self, targets: Array, steps: int) -> None:
        """Plan a path toward joint positions, shape (j,), for `steps` physics steps."""
        time: Array = self._body.physics.step_time * np.arange(1.0, steps + 1.0)
        path, _ = self._setpoints.plan(targets[np.newaxis], time)
        self._path = path[0].tolist()
        self._load = self._spring_torques()

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

    def _spring_torques(self) -> list[float]:
        """Return the gravity load of the counterbalanced joints, N m or N."""
        if not self._sprung:
            return []
        load = self._body.physics.client.calculateInverseDynamics(
            self._body.body, self._body.positions(), self._zeros, self._zeros
        )
        return [load[number] for _, number in self._sprung]
