"""Motors of the base and of the arm."""

import math

import numpy as np

from kinfeas.backends.pybullet.robot_body import RobotBody, arm_followers
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, wrap


class BaseDrive:
    """Velocity control of the planar joints within the platform's accelerations.

    The motors have the force that the maximum acceleration takes, times `drive_reserve`. The
    rotation also has to overcome the grip of the wheels, because a light base can have a long arm.
    A differential drive moves along its present heading.
    """

    def __init__(self, body: RobotBody) -> None:
        """Connect to the planar joints of a robot at rest."""
        base = body.robot.base
        self._body, self._limits = body, base
        self._omnidirectional = base.drive == "omnidirectional"
        config = body.physics.config
        force = config.drive_reserve * body.mass * base.max_acceleration
        torque = config.drive_reserve * body.yaw_inertia * base.max_rotation_acceleration
        grip = config.wheel_grip * body.mass * config.gravity
        self._forces = [force, force, max(torque, grip)]
        self.reset()

    def reset(self) -> None:
        """Set all velocities to zero."""
        self._velocity = self._target = (0.0, 0.0)  # world x and y, or along the heading and 0
        self._rotation = self._target_rotation = 0.0

    def command(self, twist: Array, dt: float) -> None:
        """Set the world twist, shape (6,), m/s and rad/s, for the next `dt` seconds.

        A differential drive follows the part of it along the heading at the end of the period, as
        in `kinfeas.control.drive`.
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
    """Position control of the arm's joints, and of those that mimic them, along cubics.

    Like a joint trajectory controller: each command starts a new cubic at the end of the previous
    one. The motors have the URDF's effort and velocity; `counterbalanced` joints have springs.
    """

    def __init__(self, body: RobotBody) -> None:
        """Connect to the arm of a robot; call `reset` next."""
        robot, followers = body.robot, arm_followers(body.robot)
        names = [joint.name for joint in robot.arm]
        self._body, self._horizon = body, body.physics.config.arm_horizon
        self._speed, self._continuous = robot.max_joint_velocity, robot.continuous
        self._leaders = [names.index(one.leader) for one in followers]
        self._multipliers = np.array([one.multiplier for one in followers])
        self._offsets = np.array([one.offset for one in followers])
        moved = [robot.urdf.joints[name] for name in (*names, *(one.name for one in followers))]
        for joint in moved:
            if joint.effort == 0.0:
                raise KinfeasError(
                    f"robot {robot.name!r}: joint {joint.name!r} has effort 0 in the URDF; it must "
                    "be above 0, or left out for no limit"
                )
        speeds = [*self._speed.tolist(), *(joint.velocity for joint in moved[len(names) :])]
        self._motors = [
            (body.joints[joint.name], joint.effort, speed)
            for joint, speed in zip(moved, speeds, strict=True)
        ]
        order = list(body.joints)
        sprung = [name for name in names if name in robot.counterbalanced]
        self._sprung = [(body.joints[name], order.index(name)) for name in sprung]
        self._zeros = [0.0] * len(order)
        self._at = self._velocity = np.zeros(len(names))

    def reset(self, joint_positions: Array) -> None:
        """Start at rest at joint positions, shape (j,)."""
        self._at, self._velocity = joint_positions.copy(), np.zeros(len(joint_positions))

    def command(self, targets: Array, steps: int) -> None:
        """Plan a path toward joint positions, shape (j,), for `steps` physics steps."""
        change = targets - self._at
        change = np.where(self._continuous, wrap(change), change)
        # The peak velocity of a cubic from rest is 1.5 times its mean. Larger changes are scaled
        # down for all joints alike, because the EE deviates less if no joint runs ahead.
        needed = float(np.max(1.5 * np.abs(change) / self._speed))
        change *= self._horizon / max(self._horizon, needed)
        time: Array = self._body.physics.step_time * np.arange(1.0, steps + 1.0)
        path, speed = cubic(self._at, self._velocity, change, self._horizon, time)
        self._at, self._velocity = path[-1], speed[-1]
        followers = self._multipliers * path[:, self._leaders] + self._offsets
        self._path = np.concatenate([path, followers], axis=1).tolist()
        self._load = self._spring_torques()

    def drive(self, step: int) -> None:
        """Command the motors for physics step number `step` since `command`."""
        client, body = self._body.physics.client, self._body.body
        # One by one: PyBullet's call for several joints ignores velocity limits.
        for (joint, effort, speed), position in zip(self._motors, self._path[step], strict=True):
            client.setJointMotorControl2(
                body, joint, client.POSITION_CONTROL, targetPosition=position, positionGain=1.0,
                force=effort, maxVelocity=speed,
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


def cubic(
    position: Array, velocity: Array, change: Array, duration: float, time: Array
) -> tuple[Array, Array]:
    """Return positions and velocities, each (t, j), along cubics that end at rest after `duration`.

    Args:
        position: Start, shape (j,), rad or m.
        velocity: At the start, shape (j,).
        change: From start to end, shape (j,).
        duration: Seconds.
        time: Seconds since the start, shape (t,).
    """
    s = np.minimum(time[:, np.newaxis] / duration, 1.0)
    rest = 1.0 - s
    path = position + velocity * duration * s * rest * rest + change * s * s * (3.0 - 2.0 * s)
    speed = velocity * rest * (1.0 - 3.0 * s) + 6.0 * change / duration * s * rest
    return path, speed
