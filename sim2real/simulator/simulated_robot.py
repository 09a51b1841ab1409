"""A robot in the PyBullet world that does what its orders say, as a real one does."""

import math
import threading
import time
from dataclasses import dataclass

import numpy as np

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.robot_body import PLANAR_JOINTS
from kinfeas.core.backend import Grip, RobotState
from kinfeas.core.spatial import Array
from kinfeas.sim2real.link import BaseReading, JointPath, JointReading, Orders
from kinfeas.sim2real.link.drive_limits import from_drive, to_drive
from kinfeas.sim2real.simulator.joint_setpoints import JointSetpoints


@dataclass(frozen=True)
class Role:
    """How a robot is played.

    Attributes:
        rate: Ticks per second: the world moves on and is measured, Hz.
        command_timeout: Seconds without a command after which the base stops by itself.
        seconds: How long; without end if None.
    """

    rate: float = 100.0
    command_timeout: float = 0.25
    seconds: float | None = None


class SimulatedRobot:
    """A robot that does what its orders say, whoever gives them."""

    def __init__(self, backend: PyBulletBackend, state: RobotState, role: Role) -> None:
        """Begin at rest.

        Args:
            backend: World that the robot stands in.
            state: Where it stands.
            role: How it is played.
        """
        self.base_commands = self.joint_commands = self.timeouts = 0
        self._backend, self._role, self._state = backend, role, state
        self._robot, self._simulation = backend.robot, backend.sims[0]
        self._arm = [joint.name for joint in self._robot.arm]
        arm = dict(zip(self._arm, state.joint_positions[0].tolist(), strict=True))
        self._setpoints = JointSetpoints(arm)
        self._velocity, self._since = np.zeros(3), -math.inf
        self._grip: Grip | None = None
        self._lock = threading.Lock()

    def orders(self) -> Orders:
        """Return what takes its orders."""
        return Orders(self._drive, self._move, self._take_grip)

    def tick(self, dt: float) -> None:
        """Do for `dt` seconds what the orders say."""
        now = time.monotonic()
        with self._lock:
            if now - self._since > self._role.command_timeout:
                self.timeouts += bool(self._velocity.any())
                self._velocity = np.zeros(3)
            velocity, grip, self._grip = self._velocity, self._grip, None
            # The motors lead to a target in that time: as the way's end for one of 0.1 s.
            ahead = now + self._simulation.physics.config.arm_horizon
            targets = self._setpoints.at(ahead)
        if grip is not None:
            self._backend.grip(grip, np.array([0]))
        joints = np.array([[targets[name] for name in self._arm]])
        pose, base = self._state.base_pose[0], self._robot.base
        twist = from_drive(base, pose, velocity, dt)[np.newaxis]
        self._state = self._backend.step(twist, joints, dt)

    def measure(self) -> tuple[BaseReading, JointReading]:
        """Return where base and joints are now.

        Raises:
            KinfeasError: If the world is gone.
        """
        with self._simulation.physics.connected():
            return self._readings()

    def _drive(self, velocity: Array) -> None:
        with self._lock:
            self._velocity, self._since = velocity, time.monotonic()
            self.base_commands += 1

    def _move(self, path: JointPath) -> None:
        with self._lock:
            self._setpoints.follow(path, time.monotonic())
            self.joint_commands += 1

    def _take_grip(self, grip: Grip) -> None:
        with self._lock:
            self._grip = grip

    def _readings(self) -> tuple[BaseReading, JointReading]:
        body, stamp = self._simulation.body, time.time()
        x, y, yaw = body.planar()
        twist = self._state.base_twist
        assert twist is not None
        velocity = to_drive(self._robot.base, self._state.base_pose[0], twist[0], 0.0)
        joints = {name: at for name, at in body.joints.items() if name not in PLANAR_JOINTS}
        states = body.physics.client.getJointStates(body.body, list(joints.values()))
        positions = dict(self._robot.fixed_joints)
        positions |= {name: one[0] for name, one in zip(joints, states, strict=True)}
        velocities = {name: one[1] for name, one in zip(joints, states, strict=True)}
        base = BaseReading(x, y, yaw, velocity, stamp)
        return base, JointReading(positions, velocities, stamp)
