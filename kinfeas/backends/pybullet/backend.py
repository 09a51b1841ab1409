"""The PyBullet world as a backend of the loop: robots with inertia, motors and contacts."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.camera import take_side_view
from kinfeas.backends.pybullet.physics import PhysicsConfig
from kinfeas.backends.pybullet.robot_body import robot_state
from kinfeas.backends.pybullet.simulation import Simulation
from kinfeas.backends.pybullet.stage import Stage, task_scene
from kinfeas.core.backend import Contacts, Grip, ObstacleDistances, RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene
from kinfeas.tasks.task import Task

MAX_BATCH = 8
"""Simulations in a process; no result depends on it."""

_FLAT = 1e-6


class PyBulletBackend:
    """n robots, each in a PyBullet world of its own.

    Attributes:
        robot: Robot that is simulated.
        scene: Room and furniture; None for a floor only.
        objects: Whether `stage` loads the scene of a task.
        max_batch: Simulations that one process should hold; one if there is a window.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        objects: bool = True,
        gui: bool = False,
        physics: PhysicsConfig | None = None,
    ) -> None:
        """Keep the settings; physics, in a window if `gui`, starts with the first use of `sims`."""
        self.robot, self.scene, self.objects = robot, scene, objects
        self.max_batch = 1 if gui else MAX_BATCH
        self._gui, self._physics = gui, physics
        self._sims: list[Simulation] = []
        self._handled: tuple[str, str, bool] | None = None
        self._positions = self._velocities = np.empty((0, 3 + len(robot.arm)))

    @property
    def sims(self) -> list[Simulation]:
        """The simulations, at least one; `reset` adds the missing ones."""
        if not self._sims:
            self.simulation(0)
        return self._sims

    def simulation(self, row: int) -> Simulation:
        """Return the simulation of a robot; missing ones are built."""
        while len(self._sims) <= row:
            gui = self._gui and not self._sims
            one = Simulation(self.robot, self.scene, gui=gui, physics=self._physics)
            self._sims.append(one)
            if self._handled is not None:
                name, link, rigid = self._handled
                one.handle(name, link, rigid=rigid)
        return self._sims[row]

    def stage(self, task: Task) -> Stage:
        """Return a task whose episodes also place its objects; call it before any other method."""
        if self.objects:
            self.scene = task_scene(task)
        return Stage(task, self)

    def contacts(self, env_id: int) -> Contacts:
        """Return the current contacts of a robot, except with the grasped link and the floor."""
        return self.sims[env_id].contacts()

    def render(self, env_id: int, goal: Array) -> NDArray[np.uint8]:
        """Return an RGB picture of a robot and its goal position (3,), shape (360, 480, 3)."""
        base = self._measure([env_id]).base_pose[env_id, :3]
        return take_side_view(self.sims[env_id].physics, base, goal)

    def handle(self, name: str, link: str, *, rigid: bool = True) -> None:
        """Set the link that closing grippers grasp; if `rigid`, it cannot turn in the hand."""
        for one in self.sims:
            one.handle(name, link, rigid=rigid)
        self._handled = name, link, rigid

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Place robots and furniture at rest; shapes as in `Backend`.

        Raises:
            KinfeasError: If a base is not level on the floor, a number is not finite, or PyBullet
                fails.
        """
        numbers: Sequence[int] = range(len(base_pose)) if env_ids is None else env_ids.tolist()
        self._check(base_pose, joint_positions, len(numbers))
        if not np.all(np.abs(base_pose[:, 2:5]) <= _FLAT):
            raise KinfeasError("the base must be upright at height 0")
        if env_ids is None:
            self._positions = np.zeros((len(numbers), 3 + len(self.robot.arm)))
            self._velocities = np.zeros_like(self._positions)
        for row, pose, joints in zip(numbers, base_pose, joint_positions, strict=True):
            self.simulation(row).reset(pose, joints)
        return self._measure(numbers)

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Start to close or open grippers; they grasp what both fingers touch."""
        for row in env_ids.tolist():
            self._sims[row].grip(grip)

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Drive bases, arms and grippers for `dt` seconds; shapes as in `Backend`.

        Raises:
            KinfeasError: If a shape, a number or `dt` is invalid, or PyBullet fails.
        """
        self._check(base_twist, joint_targets, len(self._positions))
        for row, (twist, joints) in enumerate(zip(base_twist, joint_targets, strict=True)):
            self._sims[row].step(twist, joints, dt)
        return self._measure(range(len(self._positions)))

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return the obstacles nearer than `within` metres to the bases, except grasped links."""
        found = [one.obstacle_distances(within) for one in self._sims[: len(self._positions)]]
        width = max(one.distance.shape[1] for one in found)
        place, toward = np.zeros((2, len(found), width, 2))
        distance = np.full((len(found), width), np.inf)
        for row, one in enumerate(found):
            count = one.distance.shape[1]
            place[row, :count], toward[row, :count] = one.closest_point[0], one.normal[0]
            distance[row, :count] = one.distance[0]
        return ObstacleDistances(place, toward, distance)

    def close(self) -> None:
        """End the simulations; a second call does nothing."""
        for one in self._sims:
            one.close()

    def _measure(self, rows: Sequence[int]) -> RobotState:
        """Return the state of all robots with new measurements of `rows`."""
        # Earlier states keep their arrays.
        self._positions, self._velocities = self._positions.copy(), self._velocities.copy()
        for row in rows:
            self._positions[row], self._velocities[row] = self._sims[row].measure()
        return robot_state(self.robot, self._positions, self._velocities)

    def _check(self, planar: Array, joints: Array, count: int) -> None:
        if len(planar) != count or joints.shape != (count, len(self.robot.arm)):
            raise KinfeasError(
                f"the PyBullet world holds {count} robots of {len(self.robot.arm)} arm joints, "
                f"not {len(planar)} with joint positions of shape {joints.shape}"
            )
        if not (np.isfinite(planar).all() and np.isfinite(joints).all()):
            raise KinfeasError("poses, twists and joint positions must be finite numbers")
