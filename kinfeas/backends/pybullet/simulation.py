"""One robot in a PyBullet world of its own: inertia, motors, contacts and a gripper."""

from kinfeas.backends.pybullet.arm_drive import ArmDrive
from kinfeas.backends.pybullet.base_drive import BaseDrive
from kinfeas.backends.pybullet.contacts import Contacts, Touched, contacts, touched
from kinfeas.backends.pybullet.furniture import Furniture
from kinfeas.backends.pybullet.grasp import Grasp
from kinfeas.backends.pybullet.gripper import GripperDrive
from kinfeas.backends.pybullet.nearby import Surroundings
from kinfeas.backends.pybullet.physics import Physics, PhysicsConfig
from kinfeas.backends.pybullet.robot_body import RobotBody
from kinfeas.core.backend import Grip, ObstacleDistances
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene


class Simulation:
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
            physics: Gravity, rate, friction and other numbers of the world.

        Raises:
            KinfeasError: If PyBullet is not installed.
        """
        self.physics = Physics(physics or PhysicsConfig(), gui=gui)
        self.furniture = Furniture(self.physics, scene) if scene else None
        self.body = RobotBody(self.physics, robot)
        self._base, self._arm = BaseDrive(self.body), ArmDrive(self.body)
        self._surroundings = Surroundings(self.body)
        self.gripper = GripperDrive(self.body) if robot.gripper else None
        self.grasp = Grasp(self.body, self.gripper) if self.gripper else None
        self._handled: tuple[int, int] | None = None
        self._rigid, self._reaches = True, False
        self.physics.keep()

    def handle(self, name: str, link: str, *, rigid: bool = True) -> None:
        """Set what the gripper takes hold of when it closes; it is open at each reset from now on.

        Args:
            name: Name of an object of the scene.
            link: Its link.
            rigid: Whether the link cannot turn in the hand either.

        Raises:
            KinfeasError: If there is no scene, object, link or gripper.
        """
        if self.furniture is None or self.gripper is None:
            raise KinfeasError("nothing can be handled without a scene and a gripper")
        self._handled, self._rigid = self.furniture.link(name, link), rigid

    def reset(self, base_pose: Array, joint_positions: Array) -> None:
        """Put robot and furniture at rest where they begin.

        Nothing is left of what was before: equal episodes are equal to the bit.

        Args:
            base_pose: World pose of the base on the floor, shape (7,).
            joint_positions: Arm joints, shape (j,).
        """
        with self.physics.connected():
            self._begin(base_pose, joint_positions)

    def grip(self, grip: Grip) -> None:
        """Begin to close or open the gripper; closing, it holds what both of its fingers touch.

        Only what `handle` has set is held.
        """
        if self.gripper is None or self.grasp is None:
            return
        self._reaches = grip == "close"
        if self._reaches:
            self.gripper.close()
        else:
            self.grasp.release()
            self.gripper.open()

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> None:
        """Drive base, arm and gripper.

        Args:
            base_twist: World twist of the base, shape (6,), m/s and rad/s.
            joint_targets: Joint positions to reach, shape (j,).
            dt: Duration in seconds.

        Raises:
            KinfeasError: If `dt` is not above 0, or the world is gone.
        """
        with self.physics.connected():
            steps = self._divide(dt)
            self._base.aim(base_twist, dt)
            self._arm.aim(joint_targets, steps)
            for step in range(steps):
                self._drive(step)
            self._hold()

    def measure(self) -> tuple[list[float], list[float]]:
        """Return positions and velocities of x, y, yaw and the arm's joints.

        Raises:
            KinfeasError: If the world is gone.
        """
        with self.physics.connected():
            return self.body.measure()

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return what is nearer than `within` metres to the base, but for what it handles."""
        bodies = self.furniture.bodies.values() if self.furniture else ()
        with self.physics.connected():
            return self._surroundings.obstacle_distances(bodies, within, self._spared())

    def contacts(self) -> Contacts:
        """Return what the robot touches now, but for the link that it handles."""
        return contacts(self.body, self._spared())

    def touched(self) -> Touched:
        """Return the bodies that the robot touches now, but for the link that it handles."""
        return touched(self.body, self._spared())

    def free(self) -> bool:
        """Return whether the robot touches nothing where it is."""
        self.physics.client.performCollisionDetection()
        return self.contacts() == Contacts(base=0, arm=0)

    def close(self) -> None:
        """End the world; it may be called twice."""
        self.physics.close()

    def _begin(self, base_pose: Array, joint_positions: Array) -> None:
        if self.grasp is not None:
            self.grasp.release()
        self.physics.rewind()
        if self.furniture is not None:
            self.furniture.place()
        self.body.reset(base_pose, joint_positions)
        self.physics.look_at(base_pose)
        self._base.reset()
        self._arm.reset(joint_positions)
        self._reaches = False
        if self.gripper is not None:
            self.gripper.reset()
            if self._handled is not None:
                self.gripper.open()

    def _drive(self, step: int) -> None:
        """Let physics step number `step` of a control period pass."""
        self._base.drive()
        self._arm.drive(step)
        if self.gripper is not None:
            self.gripper.drive()
        if self.grasp is not None:
            self.grasp.drive()
        self.physics.advance()

    def _hold(self) -> None:
        """Take hold of what the fingers have closed on, and let slip what is pulled too hard."""
        if self.grasp is None:
            return
        self.grasp.update()
        if self._reaches and self._handled is not None and self.grasp.held is None:
            # Once held, what slips out is lost.
            self._reaches = not self.grasp.hold(*self._handled, rigid=self._rigid)

    def _spared(self) -> tuple[tuple[int, int], ...]:
        return () if self._handled is None else (self._handled,)

    def _divide(self, dt: float) -> int:
        """Return how many physics steps a control period has, and tell those whom it concerns."""
        before = self.physics.step_time
        steps = self.physics.divide(dt)
        if self.physics.step_time != before:
            for part in (self.furniture, self.gripper):
                if part is not None:
                    part.retime()
        return steps
