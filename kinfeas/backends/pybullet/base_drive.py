"""The motors of the base: velocities on planar joints, with the platform's accelerations."""

import math

from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.spatial import Array


class BaseDrive:
    """Follows a base twist as fast as the platform can.

    The commanded velocity changes no faster than the vendor's limits allow, and the motors have
    the force that this takes with the robot's mass and inertia, with a reserve for what the arm
    does: what pushes harder moves the base. What turns it has to overcome the wheels' grip on the
    floor as well, since a light base has a long arm. A differential drive moves along its heading,
    wherever that turns meanwhile.
    """

    def __init__(self, body: RobotBody) -> None:
        """Connect to the planar joints of a robot, which stands still."""
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
        """Forget the velocity: the robot was put at rest."""
        self._velocity = self._aim = (0.0, 0.0)  # world x and y, or along the heading and 0
        self._rotation = self._turn = 0.0

    def aim(self, twist: Array, dt: float) -> None:
        """Set the world twist, shape (6,), m/s and rad/s, to follow for `dt` seconds.

        Of a twist that a differential drive cannot follow, only the part along its heading at the
        end is left, as `kinfeas.control.drive` means it.
        """
        x, y, self._turn = float(twist[0]), float(twist[1]), float(twist[5])
        if not self._omnidirectional:
            heading = self._heading() + self._turn * dt
            x, y = math.cos(heading) * x + math.sin(heading) * y, 0.0
        self._aim = (x, y)

    def drive(self) -> None:
        """Command the motors for one physics step."""
        client, time = self._body.physics.client, self._body.physics.step_time
        self._rotation += _clip(
            self._turn - self._rotation, self._limits.max_rotation_acceleration * time
        )
        self._velocity = self._nearer(self._limits.max_acceleration * time)
        x, y = self._velocity
        if not self._omnidirectional:
            heading = self._heading() + self._rotation * time
            x, y = math.cos(heading) * x, math.sin(heading) * x
        client.setJointMotorControlArray(
            self._body.body,
            self._body.base,
            client.VELOCITY_CONTROL,
            targetVelocities=[x, y, self._rotation],
            forces=self._forces,
        )

    def _nearer(self, largest: float) -> tuple[float, float]:
        """Return the velocity, changed toward the aim by no more than `largest`, in m/s."""
        x, y = self._aim[0] - self._velocity[0], self._aim[1] - self._velocity[1]
        change = math.hypot(x, y)
        if change <= largest:
            return self._aim
        share = largest / change
        return self._velocity[0] + share * x, self._velocity[1] + share * y

    def _heading(self) -> float:
        return self._body.planar()[2]


def _clip(value: float, largest: float) -> float:
    return min(max(value, -largest), largest)
