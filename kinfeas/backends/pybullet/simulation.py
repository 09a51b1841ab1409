"""One robot in a PyBullet world: motors, gripper, furniture and contacts."""

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.pybullet.furniture import Furniture, SolidBodies
from kinfeas.backends.pybullet.gripper import Grasp, GripperDrive
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.backends.pybullet.robot_body import ArmDrive, BaseDrive, RobotBody
from kinfeas.core.backend import Contacts, Grip
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene


class Simulation:
    """One robot in a room.

    Attributes:
        physics: The PyBullet world.
        body: The robot in it.
        furniture: Objects of the scene; None without one.
        solids: Solids around the robot.
        grasp: Grasp of the robot's gripper; None if its YAML has none.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None,
        physics: PhysicsConfig,
        grasped: tuple[str, str, bool] | None = None,
        *,
        gui: bool,
    ) -> None:
        """Build robot and room.

        `grasped` has an object and its link that the gripper can hold, and whether rigidly.
        """
        self.physics = Physics(physics, gui=gui)
        self.furniture = Furniture(self.physics, scene) if scene else None
        self.solids = SolidBodies(self.physics)
        self.body = RobotBody(self.physics, robot)
        self._base, self._arm = BaseDrive(self.body), ArmDrive(self.body)
        gripper = GripperDrive(self.body, robot.gripper) if robot.gripper else None
        self.grasp = Grasp(self.body, gripper) if gripper else None
        self.body.note_dynamics()
        self._handled: tuple[int, int] | None = None
        if grasped is not None and self.furniture is not None:
            self._handled, self._rigid = self.furniture.link(*grasped[:2]), grasped[2]
        self._closing = False
        self.physics.save()

    def reset(self, base_pose: Array, joint_positions: Array) -> None:
        """Place robot and furniture at rest, bit-identically: base pose (7,), arm joints (j,).

        Solids are removed.
        """
        with self.physics.connected():
            self.solids.clear()  # the saved state is without them
            self.physics.restore()
            if self.furniture is not None:
                self.furniture.place()
            self.body.reset(base_pose, joint_positions)
            self.physics.look_at(base_pose)
            self._base.reset()
            self._closing = False
            if self.grasp is not None:
                self.grasp.release()
                self.grasp.gripper.reset()
                if self._handled is not None:
                    self.grasp.gripper.move("open")

    def grip(self, grip: Grip) -> None:
        """Start to close or open the gripper.

        While it closes, it grasps the link that it can hold once both fingers touch it.
        """
        if self.grasp is None:
            return
        self._closing = grip == "close"
        if not self._closing:
            self.grasp.release()
        self.grasp.gripper.move(grip)

    def scale_dynamics(self, mass: float, friction: float, motor_gain: float) -> None:
        """Multiply masses and frictions of the robot, and the gains of the arm's motors."""
        with self.physics.connected():
            self.body.scale(mass, friction)
        self._arm.gain = motor_gain

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> None:
        """Drive base, arm and gripper: world twist (6,), joint positions (j,), dt in seconds."""
        with self.physics.connected():
            before, steps = self.physics.step_time, self.physics.divide(dt)
            if self.physics.step_time != before:
                if self.furniture is not None:
                    self.furniture.apply_step_time()
                if self.grasp is not None:
                    self.grasp.gripper.apply_step_time()
            self._base.command(base_twist, dt)
            self._arm.command(joint_targets, steps)
            for step in range(steps):
                self._base.drive()
                self._arm.drive(step)
                if self.grasp is not None:
                    self.grasp.gripper.drive()
                    self.grasp.drive()
                self.physics.client.stepSimulation()
            if self.grasp is not None:
                if self.grasp.force > self.physics.config.grasp_limit:
                    self.grasp.release()
                if self._closing and self._handled is not None and self.grasp.held is None:
                    # A link that has slipped out is not grasped again.
                    self._closing = not self.grasp.hold(*self._handled, rigid=self._rigid)

    def measure(self) -> tuple[list[float], list[float]]:
        """Return positions and velocities of x, y, yaw and the arm's joints."""
        with self.physics.connected():
            return self.body.measure()

    def contacts(self) -> Contacts:
        """Return the current contacts, except of the arm with the link to grasp.

        The robot's own links, and the floor below its base, do not count.
        """
        body = self.body
        touching = frozenset(
            (point[3], point[2], point[4])
            for point in self.physics.client.getContactPoints(bodyA=body.body)
            if point[8] <= 0.0 and point[2] != body.body
        )
        arm = frozenset(contact for contact in touching if contact[0] in body.arm_links)
        return Contacts(touching - arm, frozenset(c for c in arm if c[1:] != self._handled))
