"""The PyBullet world as a backend of the loop: robots with inertia, motors and contacts."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.physics import PhysicsConfig
from kinfeas.backends.pybullet.robot_body import robot_state
from kinfeas.backends.pybullet.simulation import Simulation
from kinfeas.core.backend import Grip, ObstacleDistances, RobotState
from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import Array
from kinfeas.robots.robot import Robot
from kinfeas.scenes.scene import Scene

_FLAT = 1e-6


class PyBulletBackend:
    """n robots, each in a PyBullet world of its own.

    Attributes:
        robot: Robot that is simulated.
        sims: The worlds, at least one; `reset` adds those that are missing.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene | None = None,
        *,
        gui: bool = False,
        physics: PhysicsConfig | None = None,
    ) -> None:
        """Build the first world; the first `reset` puts the robots where they begin.

        Args:
            robot: Robot to simulate.
            scene: Room and furniture; without one there is a floor and nothing else.
            gui: Whether to show the first world in a window.
            physics: Gravity, rate, friction and other numbers of the world.

        Raises:
            KinfeasError: If PyBullet is not installed.
        """
        self.robot = robot
        self._build = partial(Simulation, robot, scene, physics=physics)
        self.sims = [self._build(gui=gui)]
        self._handled: tuple[str, str, bool] | None = None
        self._positions = self._velocities = np.empty((0, 3 + len(robot.arm)))

    def simulation(self, row: int) -> Simulation:
        """Return the world of a robot; missing ones are built."""
        while len(self.sims) <= row:
            self.sims.append(self._build())
            if self._handled is not None:
                name, link, rigid = self._handled
                self.sims[-1].handle(name, link, rigid=rigid)
        return self.sims[row]

    def handle(self, name: str, link: str, *, rigid: bool = True) -> None:
        """Set what the grippers take hold of when they close; they are open after each reset.

        Args:
            name: Name of an object of the scene.
            link: Its link.
            rigid: Whether the link cannot turn in the hand either.

        Raises:
            KinfeasError: If there is no scene, object, link or gripper.
        """
        for one in self.sims:
            one.handle(name, link, rigid=rigid)
        self._handled = name, link, rigid

    def reset(
        self, base_pose: Array, joint_positions: Array, env_ids: NDArray[np.intp] | None = None
    ) -> RobotState:
        """Put robots and furniture at rest where they begin; shapes as in `Backend`.

        Raises:
            KinfeasError: If a base is not level on the floor, a number is not finite, or a world is
                gone.
        """
        numbers: Sequence[int] = range(len(base_pose)) if env_ids is None else env_ids.tolist()
        self._check(base_pose, joint_positions, len(numbers))
        if not np.all(np.abs(base_pose[:, 2:5]) <= _FLAT):
            raise KinfeasError("the base must stand upright on the floor, at height 0")
        if env_ids is None:
            self._positions = np.zeros((len(numbers), 3 + len(self.robot.arm)))
            self._velocities = np.zeros_like(self._positions)
        for row, pose, joints in zip(numbers, base_pose, joint_positions, strict=True):
            self.simulation(row).reset(pose, joints)
        return self._measure(numbers)

    def grip(self, grip: Grip, env_ids: NDArray[np.intp]) -> None:
        """Begin to close or open grippers; closing, they hold what both of their fingers touch."""
        for row in env_ids.tolist():
            self.sims[row].grip(grip)

    def step(self, base_twist: Array, joint_targets: Array, dt: float) -> RobotState:
        """Drive bases, arms and grippers for `dt` seconds; shapes as in `Backend`.

        Raises:
            KinfeasError: If the shapes do not fit, a number is not finite, `dt` is not above 0, or
                a world is gone.
        """
        self._check(base_twist, joint_targets, len(self._positions))
        for row, (twist, joints) in enumerate(zip(base_twist, joint_targets, strict=True)):
            self.sims[row].step(twist, joints, dt)
        return self._measure(range(len(self._positions)))

    def obstacle_distances(self, within: float) -> ObstacleDistances:
        """Return what is nearer than `within` metres to the bases, but for what they handle."""
        found = [one.obstacle_distances(within) for one in self.sims[: len(self._positions)]]
        width = max(one.distance.shape[1] for one in found)
        place, toward = np.zeros((2, len(found), width, 2))
        distance = np.full((len(found), width), np.inf)
        for row, one in enumerate(found):
            count = one.distance.shape[1]
            place[row, :count], toward[row, :count] = one.closest_point[0], one.normal[0]
            distance[row, :count] = one.distance[0]
        return ObstacleDistances(place, toward, distance)

    def close(self) -> None:
        """End the worlds; it may be called twice."""
        for one in self.sims:
            one.close()

    def _measure(self, rows: Sequence[int]) -> RobotState:
        """Return the state of all robots, of which `rows` are measured anew."""
        # Others may hold the arrays of before.
        self._positions, self._velocities = self._positions.copy(), self._velocities.copy()
        for row in rows:
            self._positions[row], self._velocities[row] = self.sims[row].measure()
        return robot_state(self.robot, self._positions, self._velocities)

    def _check(self, planar: Array, joints: Array, count: int) -> None:
        if len(planar) != count or joints.shape != (count, len(self.robot.arm)):
            raise KinfeasError(
                f"the PyBullet world holds {count} robots of {len(self.robot.arm)} arm joints, "
                f"not {len(planar)} with joint positions of shape {joints.shape}"
            )
        if not (np.isfinite(planar).all() and np.isfinite(joints).all()):
            raise KinfeasError("poses, twists and joint positions must be finite numbers")
