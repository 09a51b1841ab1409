"""Setpoints of the arm's motors, and setpoints and forces of the base's."""

import math

import numpy as np

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.robot import arm_followers
from kinfeas.core.errors import KinfeasError
from kinfeas.core.kernels import exact, exact_inlined
from kinfeas.core.motion import Rows
from kinfeas.core.pose_kernels import wrapped
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

    Each command starts a new cubic where the previous cubic ends, as in a joint trajectory
    controller.

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
        self._leaders = [arm.index(mimic.leader) for mimic in followers]
        self._multipliers = np.array([mimic.multiplier for mimic in followers])
        self._offsets = np.array([mimic.offset for mimic in followers])
        self.names = (*arm, *(mimic.name for mimic in followers))
        joints = [robot.urdf.joints[name] for name in self.names]
        for joint in joints:
            if joint.effort == 0.0:
                raise KinfeasError(
                    f"robot {robot.name!r}: joint {joint.name!r} has effort 0 in the URDF; it must "
                    "be above 0, or left out for no limit"
                )
        self.effort = [joint.effort for joint in joints]
        self.velocity = [*self._fastest.tolist(), *(joint.velocity for joint in joints[len(arm) :])]
        self.at, self.speed = np.zeros((2, n, len(arm)))
        # Compile the kernel now: a control period of a deployed robot cannot wait for it.
        self.plan(self.at, np.array([horizon]))

    def follow(self, joint_positions: Array) -> Array:
        """Return positions of all `names` for those of the arm, (..., j) to (..., j + f)."""
        mimics = self._multipliers * joint_positions[..., self._leaders] + self._offsets
        return np.concatenate([joint_positions, mimics], axis=-1)

    def reset(self, joint_positions: Array, rows: Rows | None = None) -> None:
        """Start at rest at joint positions, shape (m, j), of all or some rows."""
        index = slice(None) if rows is None else rows
        self.at[index], self.speed[index] = joint_positions, 0.0

    def plan(self, targets: Array, time: Array, rows: Rows | None = None) -> tuple[Array, Array]:
        """Return the paths toward joint positions, (m, j), and their velocities at t times.

        Args:
            targets: Joint positions, shape (m, j).
            time: Seconds since the command, shape (t,); the next command comes at the last one.
            rows: The m arms; all by default.

        Returns:
            Positions and velocities of all `names`, shape (m, t, j + f).
        """
        index = slice(None) if rows is None else rows
        path, speed = arm_paths(
            self.at[index], self.speed[index], targets, self._continuous, self._fastest,
            self._horizon, time,
        )  # fmt: skip
        self.at[index], self.speed[index] = path[:, -1], speed[:, -1]
        if self._leaders:
            rates = speed[..., self._leaders] * self._multipliers
            path, speed = self.follow(path), np.concatenate([speed, rates], axis=-1)
        return path, speed


@exact
def arm_paths(at, velocity, targets, continuous, fastest, horizon, time):
    """Return the paths of `ArmSetpoints.plan` and their velocities, shape (m, t, j)."""
    m, j = targets.shape
    path = np.empty((m, len(time), j))
    speed = np.empty_like(path)
    for i in range(m):
        change, needed = targets[i] - at[i], horizon
        for k in range(j):
            if continuous[k]:
                change[k] = wrapped(change[k])
            # The peak velocity of a cubic from rest is 1.5 times its mean.
            needed = max(needed, 1.5 * abs(change[k]) / fastest[k])
        # Larger changes are scaled down for all joints alike, because the EE deviates less if no
        # joint runs ahead.
        change *= horizon / needed
        for n in range(len(time)):
            for k in range(j):
                path[i, n, k], speed[i, n, k] = cubic(
                    at[i, k], velocity[i, k], change[k], horizon, time[n]
                )
    return path, speed


@exact_inlined
def cubic(position, velocity, change, duration, time):
    """Return position and velocity on a cubic that ends at rest after `duration` seconds.

    It starts at `position`, rad or m, with `velocity`, and ends at `position + change`. `time` is
    seconds since the start.
    """
    s = min(time / duration, 1.0)
    rest = 1.0 - s
    path = position + velocity * duration * s * rest * rest + change * s * s * (3.0 - 2.0 * s)
    return path, velocity * rest * (1.0 - 3.0 * s) + 6.0 * change / duration * s * rest


@exact
def base_path(base, rows, twist, yaw, time, differential, acceleration, rotation_acceleration):
    """Return setpoints of x, y and yaw at t times within the acceleration limits, (m, t, 3).

    A differential drive moves along its heading only, at the part of the twist along its heading at
    the end of the period, as in `kinfeas.kinematics.drive`.

    Args:
        base: Velocity setpoints of all n robots at the start, (n, 3): world x, y and yaw, or
            forward, 0 and yaw of a differential drive. Those of `rows` become the last ones.
        rows: The m robots.
        twist: Their world twists, (m, 6).
        yaw: Headings of all n robots.
        time: Seconds since the command, (t,), at equal intervals.
        differential: Whether the drive is a differential one.
        acceleration: Limit, m/s^2.
        rotation_acceleration: Limit, rad/s^2.
    """
    path = np.empty((len(rows), len(time), 3))
    for i in range(len(rows)):
        row = rows[i]
        x, y, rate, heading = twist[i, 0], twist[i, 1], twist[i, 5], yaw[row]
        if differential:
            end = heading + rate * time[-1]
            x, y = math.cos(end) * x + math.sin(end) * y, 0.0
        change_x, change_y, change_rate = x - base[row, 0], y - base[row, 1], rate - base[row, 2]
        needed = max(math.hypot(change_x, change_y) / acceleration, 1e-9)
        needed_turning = max(abs(change_rate) / rotation_acceleration, 1e-9)
        for k in range(len(time)):
            fraction, turned = min(time[k] / needed, 1.0), min(time[k] / needed_turning, 1.0)
            x, y = base[row, 0] + fraction * change_x, base[row, 1] + fraction * change_y
            rate = base[row, 2] + turned * change_rate
            heading += rate * time[0]
            path[i, k, 0] = math.cos(heading) * x if differential else x
            path[i, k, 1] = math.sin(heading) * x if differential else y
            path[i, k, 2] = rate
        base[row, 0], base[row, 1], base[row, 2] = x, y, rate
    return path
