"""A physics world as a backend of the loop: checks, measurements and tasks with objects."""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import chain
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from kinfeas.backends.physics.config import PhysicsConfig
from kinfeas.backends.physics.stage import Stage, StreamStage
from kinfeas.core.backend import (
    Backend,
    Contacts,
    Grip,
    ObstacleDistances,
    RobotState,
    Scan,
)
from kinfeas.core.errors import KinfeasError
from kinfeas.core.motion import Rows
from kinfeas.core.solids import MovingSolids, Solids
from kinfeas.core.spatial import Array, compose, planar_pose, wrap
from kinfeas.kinematics.self_collision import build_collision_model
from kinfeas.kinematics.sensing import base_obstacles, fine_base_prisms, scan
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene, read_scene, solids_around
from kinfeas.tasks.chain import ChainTask
from kinfeas.tasks.task import StreamTask, Task

_FLAT = 1e-6  # largest z (m), qx and qy of a base that is level on the floor
_MAX_BATCH = 8  # simulations of ended episodes cost as much as others until the last one ends

ROBOT = ""
"""Stands for the robot in place of the name of an object."""

LinkName = tuple[str, str]
"""Name of an object, or `ROBOT`, and of a link."""

Motion = tuple[dict[str, float], dict[str, float]]
"""Positions, rad or m, and velocities, rad/s or m/s, by the name of the joint."""


class PhysicsBackend(Backend):
    """n robots, each in a room of its own.

    Attributes:
        engine: Name of the engine in errors.
        config: Numbers of the physics.
        robot: Robot that is simulated.
        scene: Room and furniture; None for a floor only.
        furniture: Number of the first places of solids that hold the furniture of the scene, which
            is in the engine already.
        objects: Whether `stage` sets up the scene of a task.
    """

    engine: ClassVar[str]
    solids: MovingSolids
    _handled: tuple[str, str, bool] | None = None  # object, link, `rigid` of `handle`
    _standing: Solids | None = None  # links that cannot move; None after a reset

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        objects: bool = True,
        gui: bool = False,
        physics: PhysicsConfig | None = None,
    ) -> None:
        """Keep the settings; the first use starts the physics, in a window if `gui`."""
        self.robot, self.scene, self.config = robot, scene, physics or PhysicsConfig()
        self.arm_seconds = self.config.arm_horizon
        self.objects, self._gui = objects, gui
        self._positions = self._velocities = np.empty((0, 3 + len(robot.arm)))
        self.solids, self.furniture = MovingSolids(), 0
        self.gripper = self.scanner = self.obstacles = self.contacts = self.dynamics = self
        self.staging = self
        self.max_batch = 1 if gui else _MAX_BATCH

    def stage(self, task: Task) -> Stage:
        """Return a task whose episodes also place its objects; call it before the first reset."""
        if self.objects:
            scene = task.scene if isinstance(task, ChainTask) else None
            self.scene = read_scene(scene.name) if scene else None
        if isinstance(task, StreamTask):
            stage: Stage = StreamStage(task, task, self)
        else:
            stage = Stage(task, self)
        self.open()  # shows errors early
        return stage

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: Rows | None = None
    ) -> RobotState:
        """Place robots and furniture at rest, without solids; shapes as in `Backend`.

        Raises:
            KinfeasError: If a base is not level on the floor, a number is not finite, or the engine
                fails.
        """
        rows = np.arange(len(base_pose)) if env_ids is None else env_ids
        self._check(base_pose, joint_positions, len(rows))
        if not np.all(np.abs(base_pose[:, 2:5]) <= _FLAT):
            raise KinfeasError("the base must be upright at height 0")
        if env_ids is None:
            self._positions = np.zeros((len(rows), 3 + len(self.robot.arm)))
            self._velocities = np.zeros_like(self._positions)
        self._reset(rows, base_pose, joint_positions)
        self._standing = None
        self.solids.place(None, rows, len(self._positions))
        return self._measure(rows)

    def place_solids(self, solids: Solids | None, env_ids: Rows) -> None:
        """Put solids around robots; arguments as in `Backend`."""
        self.solids.place(solids, env_ids, len(self._positions))
        if (bodies := self.solid_bodies()) is not None:
            self._place_solids(env_ids, bodies)

    def solid_bodies(self) -> Solids | None:
        """Return the solids that are no furniture, at their present poses; None without any."""
        present = self.solids.after()
        if present is None or present.places <= self.furniture:
            return None
        return present.beyond(self.furniture)

    def scan(self) -> Scan:
        """Return the ranges to solids around the true bases."""
        return Scan(scan(self.solids.after(), planar_pose(*self._positions[:, :3].T)))

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return obstacles closer than `within` metres to the true bases, as in `ObstacleSensor`.

        Obstacles are the objects of the scene at their present poses, without the link to grasp,
        and the solids.
        """
        if self._standing is None:
            self._standing = self._links_as_solids(moving=False)
        solids = self._standing.joined(self._links_as_solids(moving=True))
        if (beside := self.solid_bodies()) is not None:
            solids = solids.joined(beside)
        base = planar_pose(*self._positions[:, :3].T)
        return base_obstacles(self._prisms, base, solids, within)

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Drive bases, arms and grippers for `dt` seconds; shapes as in `Backend`.

        Raises:
            KinfeasError: If a shape, a number or `dt` is invalid, or the engine fails.
        """
        self._check(base_twist, joint_targets, len(self._positions))
        rows = np.arange(len(self._positions))
        # Solids move first, so that contacts at the end of the period are with their poses then.
        self.solids.step(dt)
        if self.solids.moving.any() and (bodies := self.solid_bodies()) is not None:
            self._move_solids(bodies)
        self._step(rows, base_twist, joint_targets, dt)
        return self._measure(rows)

    def handle(self, name: str, link: str, *, rigid: bool = True) -> None:
        """Set the link that closing grippers grasp; call it before robots are placed.

        If `rigid`, it cannot turn in the hand.
        """
        if self.scene is None or self.robot.gripper is None:
            raise KinfeasError("grasping needs a scene and a robot with a gripper")
        self._handled = name, link, rigid
        self.close()  # the next use builds simulations with it

    def hold(self, row: int, joint_positions: Array, dt: float, periods: int) -> None:
        """Hold a robot still for some periods of `dt` seconds, its arm at positions (j,)."""
        rows, still = np.array([row]), np.zeros((1, 6))
        for _ in range(periods):
            self._step(rows, still, joint_positions[np.newaxis], dt)

    @cached_property
    def _prisms(self) -> Array:
        return fine_base_prisms(build_collision_model(self.robot), self._base_meshes())

    def _links_as_solids(self, *, moving: bool) -> Solids:
        """Return the links of the scene that can move, or cannot, but never the link to grasp."""
        objects, grasped = self.scene.objects if self.scene else {}, (self._handled or ())[:2]
        links = {
            (name, link.name): link.shapes
            for name, item in objects.items()
            for link in item.urdf.links.values()
            if link.shapes and (name, link.name) != grasped
            if moving != (item.fixed and link.name in item.urdf.rigid[item.urdf.root])
        }
        rows = range(len(self._positions))
        if not links:
            return Solids.empty(len(rows))
        shapes = list(chain.from_iterable(links.values()))
        frames = np.stack([self.link_poses(row, list(links)) for row in rows])
        owner = np.repeat(np.arange(len(links)), [*map(len, links.values())])
        local = np.array([shape.pose for shape in shapes])
        return solids_around(shapes, compose(frames[:, owner], local))

    def _measure(self, rows: Rows) -> RobotState:
        """Return the state of all robots, `rows` measured anew; continuous joints in (-pi, pi]."""
        # Copied, because earlier states share the arrays.
        self._positions, self._velocities = self._positions.copy(), self._velocities.copy()
        self._positions[rows], self._velocities[rows] = self._read(rows)
        twist = np.zeros((len(self._positions), 6))
        twist[:, [0, 1, 5]] = self._velocities[:, :3]
        base, joints = planar_pose(*self._positions[:, :3].T), self._positions[:, 3:]
        joints = np.where(self.robot.continuous, wrap(joints), joints)
        return RobotState(base, joints, base_twist=twist, joint_velocities=self._velocities[:, 3:])

    def _check(self, planar: Array, joints: Array, count: int) -> None:
        if len(planar) != count or joints.shape != (count, len(self.robot.arm)):
            raise KinfeasError(
                f"the {self.engine} world holds {count} robots of {len(self.robot.arm)} arm "
                f"joints, not {len(planar)} with joint positions of shape {joints.shape}"
            )
        if not (np.isfinite(planar).all() and np.isfinite(joints).all()):
            raise KinfeasError("poses, twists and joint positions must be finite numbers")

    @abstractmethod
    def open(self) -> None:
        """Build the first simulation; a second call does nothing."""

    @abstractmethod
    def grip(self, grip: Grip, env_ids: Rows) -> None:
        """Start to close or open grippers.

        Closing ones grasp the link set by `handle` as soon as both fingers touch it.
        """

    @abstractmethod
    def scale_dynamics(
        self, mass: Array, friction: Array, motor_gain: Array, env_ids: Rows
    ) -> None:
        """Change the dynamics of robots, as in `Dynamics`."""

    @abstractmethod
    def touching(self, env_id: int) -> Contacts:
        """Return contacts of a robot, except base with floor and arm with the link to grasp."""

    @abstractmethod
    def place(
        self, row: int, scene: Scene | None, base_pose: Array, joint_positions: Array
    ) -> bool:
        """Place robot and objects of a row, and return whether the robot has no contact.

        The base pose is (7,), the joints (j,). Later resets of the row place the same objects.
        """

    @abstractmethod
    def object_motion(self, row: int, name: str) -> tuple[Array, float]:
        """Return pose (7,) and linear speed (m/s) of the root link of an object."""

    @abstractmethod
    def object_joint(self, row: int, name: str, joint: str) -> float:
        """Return the position of an object's joint, rad or m."""

    @abstractmethod
    def is_on(self, row: int, name: str, below: str, steepest: float) -> bool:
        """Return whether an object is on the object `below`.

        A normal of their contacts has a vertical part of at least `steepest`.
        """

    @abstractmethod
    def holds(self, row: int, name: str) -> bool:
        """Return whether the gripper holds an object."""

    @abstractmethod
    def link_poses(self, row: int, links: Sequence[LinkName]) -> Array:
        """Return the world poses of links of a row, shape (k, 7)."""

    @abstractmethod
    def joint_motion(self) -> Motion:
        """Return the motion of all joints of the first robot except those of its base."""

    @abstractmethod
    def touched(self, row: int = 0) -> list[str]:
        """Return the names of the objects that the robot touches; the floor is `the floor`."""

    @abstractmethod
    def _base_meshes(self) -> Iterable[Array]:
        """Return the vertices of the base's collision meshes in its frame, (v, 3), metres."""

    @abstractmethod
    def _reset(self, rows: Rows, base_pose: Array, joint_positions: Array) -> None:
        """Place robots and furniture of m rows, and take their solids away."""

    @abstractmethod
    def _place_solids(self, rows: Rows, solids: Solids) -> None:
        """Put solids, which have all n rows, around the m robots `rows`, which have been reset."""

    @abstractmethod
    def _move_solids(self, solids: Solids) -> None:
        """Move the solids of all n rows."""

    @abstractmethod
    def _step(self, rows: Rows, base_twist: Array, joint_targets: Array, dt: float) -> None: ...

    @abstractmethod
    def _read(self, rows: Rows) -> tuple[ArrayLike, ArrayLike]:
        """Return positions and velocities of x, y, yaw and the arm's joints, (m, 3 + j)."""
