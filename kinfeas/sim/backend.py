"""The PyBullet world as a backend of the loop: one robot, with inertia, motors and contacts."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from kinfeas.backend import RobotState
from kinfeas.errors import KinfeasError
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.sim.arm_drive import ArmDrive
from kinfeas.sim.base_drive import BaseDrive
from kinfeas.sim.contacts import Contacts, contacts
from kinfeas.sim.furniture import Furniture
from kinfeas.sim.grasp import Grasp
from kinfeas.sim.gripper import GripperDrive
from kinfeas.sim.physics import Physics, PhysicsConfig
from kinfeas.sim.robot_body import RobotBody
from kinfeas.spatial import Array

_FLAT = 1e-6


class PyBulletBackend:
    """One robot in a room. After a reset, nothing moves but by forces.

    Attributes:
        physics: The world.
        body: The robot in it.
        furniture: What stands there; None without a scene.
        gripper: The robot's gripper; None if its YAML file has none.
        grasp: What the gripper holds; None without a gripper.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        gui: bool = False,
        physics: PhysicsConfig | None = None,
    ) -> None:
        """Build the world; the first `reset` puts the robot where it begins.

        Args:
            robot: Robot to simulate.
            scene: Room and furniture; without one there is a floor and nothing else.
            gui: Whether to show the world in a window.
            physics: Numbers of the world.

        Raises:
            KinfeasError: If PyBullet is not installed.
        """
        self.physics = Physics(physics or PhysicsConfig(), gui=gui)
        self.furniture = Furniture(self.physics, scene) if scene else None
        self.body = RobotBody(self.physics, robot)
        self._base, self._arm = BaseDrive(self.body), ArmDrive(self.body)
        self.gripper = GripperDrive(self.body) if robot.gripper else None
        self.grasp = Grasp(self.body, self.gripper) if self.gripper else None
        self.physics.keep()

    def reset(
        self, base_pose: Array, joint_positions: Array, rows: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Put robot and furniture at rest where they begin; shapes as in `Backend`.

        Nothing is left of what was before: equal episodes are equal to the bit.

        Raises:
            KinfeasError: If there is not exactly one robot, or its base stands not on the floor.
        """
        self._check_one(base_pose, joint_positions)
        tilt = np.abs(base_pose[0, 2:5])
        if not np.all(tilt <= _FLAT):
            raise KinfeasError("the base must stand upright on the floor, at height 0")
        if self.grasp is not None:
            self.grasp.release()
        self.physics.rewind()
        if self.furniture is not None:
            self.furniture.place()
        self.body.reset(base_pose[0], joint_positions[0])
        self._base.reset()
        self._arm.reset(joint_positions[0])
        if self.gripper is not None:
            self.gripper.reset()
        return self.body.state()

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Drive base, arm and gripper for `dt` seconds; shapes as in `Backend`.

        Raises:
            KinfeasError: If there is not exactly one robot, or `dt` is not above 0.
        """
        self._check_one(base_twist, joint_targets)
        steps = self._divide(dt)
        self._base.aim(base_twist[0], dt)
        self._arm.aim(joint_targets[0], steps)
        for step in range(steps):
            self._base.drive()
            self._arm.drive(step)
            if self.gripper is not None:
                self.gripper.drive()
            self.physics.advance()
        if self.grasp is not None:
            self.grasp.update()
        return self.body.state()

    def contacts(self, handled: Collection[int] = ()) -> Contacts:
        """Return what the robot touches now, but for the bodies of the numbers `handled`."""
        return contacts(self.body, handled)

    def close(self) -> None:
        """End the world; it may be called twice."""
        self.physics.close()

    def _divide(self, dt: float) -> int:
        """Return how many physics steps a control period has, and tell those whom it concerns."""
        before = self.physics.step_time
        steps = self.physics.divide(dt)
        if self.physics.step_time != before:
            for part in (self.furniture, self.gripper, self.grasp):
                if part is not None:
                    part.retime()
        return steps

    def _check_one(self, planar: Array, joints: Array) -> None:
        if len(planar) != 1 or joints.shape != (1, len(self.body.arm)):
            raise KinfeasError(
                f"the PyBullet world holds one robot of {len(self.body.arm)} arm joints, "
                f"not {len(planar)} with joint positions of shape {joints.shape}"
            )
        if not (np.isfinite(planar).all() and np.isfinite(joints).all()):
            raise KinfeasError("poses, twists and joint positions must be finite numbers")
