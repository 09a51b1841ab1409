"""Setpoints of the arm's motors, and forces of the base's."""

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.kernels import arm_paths
from kinfeas.backends.physics.robot import arm_followers
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot


def base_forces(
    robot: Robot, config: PhysicsConfig, mass: float, yaw_inertia: float
) -> tuple[float, float, float]:
    """Return the largest forces of the base's motors along x and y and about z, N and N m.

    They are what the maximum acceleration takes, times `drive_reserve`. The rotation also has to
    overcome the grip of the wheels, because a light base can have a long arm.
    """
    force = config.drive_reserve * mass * robot.base.max_acceleration
    torque = config.drive_reserve * yaw_inertia * robot.base.max_rotation_acceleration
    return force, force, max(torque, config.wheel_grip * mass * config.gravity)


class ArmSetpoints:
    """Paths of n arms, and of the joints that mimic theirs, along cubics.

    Like a joint trajectory controller: each command starts a new cubic at the end of the previous
    one.

    Attributes:
        names: The arm's joints, then those that mimic them.
        effort: Effort limit of each in the URDF, N m or N.
        velocity: Velocity limit of each, rad/s or m/s.
        at: Setpoint of each arm joint, shape (n, j), rad or m.
        speed: Its velocity, shape (n, j).
    """

    def __init__(self, robot: Robot, horizon: float, n: int = 1) -> None:
        """Set n arms up that reach a target within `horizon` seconds; call `reset` next."""
        self._horizon, self._fastest = horizon, robot.max_joint_velocity
        self._continuous = robot.continuous
        arm, followers = [joint.name for joint in robot.arm], arm_followers(robot)
        self._leaders = [arm.index(one.leader) for one in followers]
        self._multipliers = np.array([one.multiplier for one in followers])
        self._offsets = np.array([one.offset for one in followers])
        self.names = (*arm, *(one.name for one in followers))
        moved = [robot.urdf.joints[name] for name in self.names]
        for joint in moved:
            if joint.effort == 0.0:
                raise KinfeasError(
                    f"robot {robot.name!r}: joint {joint.name!r} has effort 0 in the URDF; it must "
                    "be above 0, or left out for no limit"
                )
        self.effort = [joint.effort for joint in moved]
        self.velocity = [*self._fastest.tolist(), *(one.velocity for one in moved[len(arm) :])]
        self.at, self.speed = np.zeros((2, n, len(arm)))
        # A period of a deployed robot cannot wait until the kernel is compiled.
        self.plan(self.at, np.array([horizon]))

    def follow(self, joint_positions: Array) -> Array:
        """Return positions of all `names` for those of the arm, (..., j) to (..., j + f)."""
        followers = self._multipliers * joint_positions[..., self._leaders] + self._offsets
        return np.concatenate([joint_positions, followers], axis=-1)

    def reset(self, joint_positions: Array, rows: NDArray[np.intp] | None = None) -> None:
        """Start at rest at joint positions, shape (m, j), of all or some rows."""
        where = slice(None) if rows is None else rows
        self.at[where], self.speed[where] = joint_positions, 0.0

    def plan(
        self, targets: Array, time: Array, rows: NDArray[np.intp] | None = None
    ) -> tuple[Array, Array]:
        """Return the paths toward joint positions, (m, j), and their velocities at t times.

        Args:
            targets: Joint positions, shape (m, j).
            time: Seconds since the command, shape (t,); the next command comes at the last one.
            rows: The m arms; all by default.

        Returns:
            Positions and velocities of all `names`, shape (m, t, j + f).
        """
        where = slice(None) if rows is None else rows
        path, speed = arm_paths(
            self.at[where], self.speed[where], targets, self._continuous, self._fastest,
            self._horizon, time,
        )  # fmt: skip
        self.at[where], self.speed[where] = path[:, -1], speed[:, -1]
        if self._leaders:
            rates = speed[..., self._leaders] * self._multipliers
            path, speed = self.follow(path), np.concatenate([speed, rates], axis=-1)
        return path, speed
