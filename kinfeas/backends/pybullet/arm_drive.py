"""The motors of the arm: positions, along cubics that end at rest, with the joints' limits."""

from collections.abc import Iterable

import numpy as np

from kinfeas.backends.pybullet.moving_joints import arm_followers
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, wrap
from kinfeas.robots.tree import Joint


def cubic(
    position: Array, velocity: Array, change: Array, duration: float, time: Array
) -> tuple[Array, Array]:
    """Return positions and velocities along cubics that end at rest together, and stay there.

    Args:
        position: Where they begin, shape (j,), rad or m.
        velocity: How fast they begin, shape (j,).
        change: How far they lead, shape (j,).
        duration: Seconds that they last.
        time: Moments since the beginning in seconds, shape (t,).

    Returns:
        Two arrays of shape (t, j).
    """
    s = np.minimum(time[:, np.newaxis] / duration, 1.0)
    rest = 1.0 - s
    way = position + velocity * duration * s * rest * rest + change * s * s * (3.0 - 2.0 * s)
    speed = velocity * rest * (1.0 - 3.0 * s) + 6.0 * change / duration * s * rest
    return way, speed


class ArmDrive:
    """Leads the arm's joints, and those that follow them, to where they are sent.

    As a joint trajectory controller does: each command begins a new cubic where the last one has
    come to. Motors pull the joints along it with the URDF's effort and velocity, springs carry
    what the robot's YAML file says they do.
    """

    def __init__(self, body: RobotBody) -> None:
        """Connect to the arm of a robot, which `reset` must follow.

        Raises:
            KinfeasError: If a joint of it has no effort.
        """
        robot, followers = body.robot, arm_followers(body.robot)
        names = [joint.name for joint in robot.arm]
        self._body, self._horizon = body, body.physics.config.arm_horizon
        self._speed, self._continuous = robot.max_joint_velocity, robot.continuous
        self._leaders = [names.index(one.leader) for one in followers]
        self._multipliers = np.array([one.multiplier for one in followers])
        self._offsets = np.array([one.offset for one in followers])
        moved = [robot.urdf.joints[name] for name in (*names, *(one.name for one in followers))]
        _check_efforts(robot.name, moved)
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
        """Begin at rest at joint positions, shape (j,)."""
        self._at, self._velocity = joint_positions.copy(), np.zeros(len(joint_positions))

    def aim(self, targets: Array, steps: int) -> None:
        """Set out for joint positions, shape (j,), on a way for `steps` physics steps."""
        change = targets - self._at
        change = np.where(self._continuous, wrap(change), change)
        # From rest, a cubic is at its fastest 1.5 times as fast as on average. What takes longer is
        # gone a part of, so that no joint runs ahead of the slowest: the hand would stray farther.
        needed = float(np.max(1.5 * np.abs(change) / self._speed))
        change *= self._horizon / max(self._horizon, needed)
        time: Array = self._body.physics.step_time * np.arange(1.0, steps + 1.0)
        way, speed = cubic(self._at, self._velocity, change, self._horizon, time)
        self._at, self._velocity = way[-1], speed[-1]
        led = self._multipliers * way[:, self._leaders] + self._offsets
        self._way = np.concatenate([way, led], axis=1).tolist()
        self._load = self._weight()

    def drive(self, step: int) -> None:
        """Command the motors for physics step number `step` since `aim`."""
        client, body = self._body.physics.client, self._body.body
        # One by one: PyBullet's calls for several joints at once know no velocity limits.
        move, mode = client.setJointMotorControl2, client.POSITION_CONTROL
        for (joint, effort, speed), position in zip(self._motors, self._way[step], strict=True):
            move(
                body,
                joint,
                mode,
                targetPosition=position,
                positionGain=1.0,
                force=effort,
                maxVelocity=speed,
            )
        if self._sprung:
            joints = [joint for joint, _ in self._sprung]
            client.setJointMotorControlArray(body, joints, client.TORQUE_CONTROL, forces=self._load)

    def _weight(self) -> list[float]:
        """Return what the springs have to carry now, N m or N."""
        if not self._sprung:
            return []
        load = self._body.physics.client.calculateInverseDynamics(
            self._body.body, self._body.positions(), self._zeros, self._zeros
        )
        return [load[number] for _, number in self._sprung]


def _check_efforts(robot: str, joints: Iterable[Joint]) -> None:
    for joint in joints:
        if joint.effort == 0.0:
            raise KinfeasError(
                f"robot {robot!r}: the URDF gives joint {joint.name!r} an effort of 0, with which "
                "no motor carries the arm; it must be above 0, or left out for no limit"
            )
