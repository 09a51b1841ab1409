"""One robot in a PyBullet world: motors, gripper, furniture, contacts and nearby obstacles."""

from collections.abc import Collection, Iterable

import numpy as np

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.obstacles import Obstacle, Shape, is_beside, obstacles_around
from kinfeas.backends.pybullet.furniture import Furniture, SolidBodies
from kinfeas.backends.pybullet.gripper import Grasp, GripperDrive
from kinfeas.backends.pybullet.physics import Physics
from kinfeas.backends.pybullet.robot_body import ArmDrive, BaseDrive, RobotBody
from kinfeas.core.backend import Contacts, Grip
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array, rotation
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene

_OUTSIDE = 1e-3  # m before a corner where its ray starts, so that it does not hit the robot
_HIGH = 1e3  # m above and below the base within which there may be obstacles
_UNIT_BOX = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T


class Simulation:
    """One robot in a room.

    Attributes:
        physics: The PyBullet world.
        body: The robot in it.
        furniture: Objects of the scene; None without one.
        solids: Solids around the robot.
        gripper: The robot's gripper; None if its YAML has none.
        grasp: Grasp of the gripper; None without one.
    """

    def __init__(
        self, robot: Robot, scene: Scene | None, physics: PhysicsConfig, *, gui: bool
    ) -> None:
        """Build the world; arguments as in `PyBulletBackend`."""
        self.physics = Physics(physics, gui=gui)
        self.furniture = Furniture(self.physics, scene) if scene else None
        self.solids = SolidBodies(self.physics)
        self.body = RobotBody(self.physics, robot)
        self._base, self._arm = BaseDrive(self.body), ArmDrive(self.body)
        self._surroundings = Surroundings(self.body)
        self.gripper = GripperDrive(self.body, robot.gripper) if robot.gripper else None
        self.grasp = Grasp(self.body, self.gripper) if self.gripper else None
        self.body.note_dynamics()
        self._handled: tuple[int, int] | None = None
        self._rigid, self._closing = True, False
        self.physics.save()

    def handle(self, name: str, link: str, *, rigid: bool = True) -> None:
        """Set the link that the gripper can grasp; arguments as in `PyBulletBackend`."""
        if self.furniture is None or self.gripper is None:
            raise KinfeasError("grasping needs a scene and a robot with a gripper")
        self._handled, self._rigid = self.furniture.link(name, link), rigid

    def reset(self, base_pose: Array, joint_positions: Array) -> None:
        """Place robot and furniture at rest, equal to the bit: base pose (7,), arm joints (j,).

        Solids are taken away.
        """
        with self.physics.connected():
            if self.grasp is not None:
                self.grasp.release()
            self.solids.clear()  # the saved state is without them
            self.physics.restore()
            if self.furniture is not None:
                self.furniture.place()
            self.body.reset(base_pose, joint_positions)
            self.physics.look_at(base_pose)
            self._base.reset()
            self._arm.reset(joint_positions)
            self._closing = False
            if self.gripper is not None:
                self.gripper.reset()
                if self._handled is not None:
                    self.gripper.move("open")

    def grip(self, grip: Grip) -> None:
        """Start to close or open the gripper.

        While it closes, it grasps the link set by `handle` once both fingers touch it.
        """
        if self.gripper is None or self.grasp is None:
            return
        self._closing = grip == "close"
        if not self._closing:
            self.grasp.release()
        self.gripper.move(grip)

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
                for part in (self.furniture, self.gripper):
                    if part is not None:
                        part.apply_step_time()
            self._base.command(base_twist, dt)
            self._arm.command(joint_targets, steps)
            for step in range(steps):
                self._base.drive()
                self._arm.drive(step)
                if self.gripper is not None:
                    self.gripper.drive()
                if self.grasp is not None:
                    self.grasp.drive()
                self.physics.client.stepSimulation()
            if self.grasp is not None:
                self.grasp.update()
                if self._closing and self._handled is not None and self.grasp.held is None:
                    # A link that has slipped out is not grasped again.
                    self._closing = not self.grasp.hold(*self._handled, rigid=self._rigid)

    def measure(self) -> tuple[list[float], list[float]]:
        """Return positions and velocities of x, y, yaw and the arm's joints."""
        with self.physics.connected():
            return self.body.measure()

    def obstacles(self, within: float) -> list[Obstacle]:
        """Return the obstacles nearer than `within` metres, except the grasped link."""
        furniture = self.furniture.bodies.values() if self.furniture else ()
        bodies = [*furniture, *self.solids.bodies.values()]
        with self.physics.connected():
            return self._surroundings.around(bodies, within, self._spared())

    def contacts(self) -> Contacts:
        """Return the current contacts, except with the grasped link.

        The robot's own links, and the floor below its base, do not count.
        """
        body, spared = self.body, self._spared()
        touching = frozenset(
            (point[3], point[2], point[4])
            for point in self.physics.client.getContactPoints(bodyA=body.body)
            if point[8] <= 0.0 and point[2] != body.body and (point[2], point[4]) not in spared
        )
        arm = frozenset(contact for contact in touching if contact[0] in body.arm_links)
        return Contacts(touching - arm, arm)

    def free(self) -> bool:
        """Return whether the robot has no contact at its present pose."""
        self.physics.client.performCollisionDetection()
        touching = self.contacts()
        return not (touching.base or touching.arm)

    def close(self) -> None:
        """End the world; a second call does nothing."""
        self.physics.close()

    def _spared(self) -> tuple[tuple[int, int], ...]:
        return () if self._handled is None else (self._handled,)


class Surroundings:
    """Measures the obstacles around a robot's base.

    Args:
        body: The robot with its base at the origin.
    """

    def __init__(self, body: RobotBody) -> None:
        self._body = body
        self._shapes = _shapes(body)
        corners = [np.zeros((1, 2)), *(shape.corners for shape in self._shapes)]
        self._radius = np.linalg.norm(np.concatenate(corners), axis=1).max()

    def around(
        self, bodies: Iterable[int], within: float, handled: Collection[tuple[int, int]] = ()
    ) -> list[Obstacle]:
        """Return the obstacles within a distance (m), except `handled` links."""

        def cast(points: Array, ahead: Array, height: float) -> list[Obstacle]:
            heights = np.full((len(points), 1), height)
            begins, ends = (
                np.hstack([points + length * ahead, heights]).tolist()
                for length in (_OUTSIDE, within)
            )
            hits = self._body.physics.client.rayTestBatch(begins, ends)
            return [
                Obstacle(
                    point, -np.array(normal[:2]), float((point - hit[:2]) @ normal[:2]), hit[2]
                )
                for point, (other, link, _, hit, normal) in zip(points, hits, strict=True)
                if other not in (-1, self._body.body) and (other, link) not in handled
                if is_beside(normal)
            ]

        near = self._near(within)
        nearest = (self._closest(other, within, handled) for other in bodies if other in near)
        return obstacles_around(self._body.planar(), nearest, self._shapes, cast)

    def _near(self, within: float) -> frozenset[int]:
        """Return the bodies whose bounding boxes are within a distance of the base."""
        x, y, _ = self._body.planar()
        reach = self._radius + within
        corners = [x - reach, y - reach, -_HIGH], [x + reach, y + reach, _HIGH]
        overlapping = self._body.physics.client.getOverlappingObjects(*corners)
        return frozenset(body for body, _ in overlapping)

    def _closest(
        self, other: int, within: float, handled: Collection[tuple[int, int]]
    ) -> list[Obstacle]:
        """Return the nearest points of each link of the base to each link of another body."""
        body = self._body
        points = body.physics.client.getClosestPoints(body.body, other, within)
        return [
            # The normal points from the object to the robot.
            Obstacle(np.array(point[:2]), -np.array(normal[:2]), distance, point[2])
            for _, _, _, own, link, point, _, normal, distance, *_ in points
            if own not in body.arm_links and (other, link) not in handled and is_beside(normal)
        ]


def _shapes(body: RobotBody) -> tuple[Shape, ...]:
    """Return the boxes and meshes of the links that the arm does not carry."""
    client, outlines = body.physics.client, []
    for link in sorted({*body.links.values()} - body.arm_links):
        frame = body.physics.mass_pose(body.body, link)
        shapes = client.getCollisionShapeData(body.body, link)
        for number, (_, _, kind, size, _, position, orientation) in enumerate(shapes):
            if kind == client.GEOM_BOX:
                pose = np.concatenate([position, orientation])
                corners = _transformed(_UNIT_BOX * size, pose)
            elif kind == client.GEOM_MESH:  # cylinders, too
                corners = np.array(client.getMeshData(body.body, link, number)[1])
            elif kind == client.GEOM_CAPSULE:
                pose, (length, radius, _) = np.concatenate([position, orientation]), size
                around = np.array([2.0 * radius, 2.0 * radius, length + 2.0 * radius])
                corners = _transformed(_UNIT_BOX * around, pose)
            else:  # spheres
                continue
            corners = _transformed(corners, frame)
            outlines.append(Shape.around(corners))
    return tuple(outlines)


def _transformed(points: Array, pose: Array) -> Array:
    return points @ rotation(pose).as_matrix().T + pose[:3]
