"""A simulated robot that follows live targets step by step, for pages and programs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kinfeas.config import PluginSpec
from kinfeas.config.recipes import load_section
from kinfeas.control.assemble import assemble, build_simulator
from kinfeas.core import spatial
from kinfeas.core.backend import closed_on_error
from kinfeas.core.spatial import Array
from kinfeas.core.start import Start, stacked
from kinfeas.kinematics.ik import IkSolver
from kinfeas.policies.loading import load_policy
from kinfeas.robots.robot import Robot, joint_displacement
from kinfeas.scenes.scene import Scene
from kinfeas.sim2real.deploy.config import ServoConfig
from kinfeas.sim2real.servo.controller import TargetController
from kinfeas.tasks.task import MotionSpec, build_subgoals, start_at_home

DT = 0.02
"""Control period, seconds."""

_NEAR = (1e-3, 5e-3)  # m and rad from the target, within which the EE has arrived
_UNLIMITED = 1e3  # m, m/s and rad/s: no limit on the motion of targets


class Episode:
    """A simulated robot whose EE follows targets, step by step.

    Attributes:
        loop: Control loop of the robot.
        backend: World of the robot.
        controller: Takes the targets; its clock is the simulated time.
        feasible: Whether IK solved for the last desired EE pose.
        deviation: Distance of the EE from the desired position, metres.
        joint_speeds: Joint speeds of the last step as fractions of their limits, shape (j,).
    """

    def __init__(
        self,
        robot: Robot,
        policy: str = "pretrained",
        scene: Scene | None = None,
        *,
        generator: str = "servo",
        filters: Sequence[str] = ("time_scaling",),
        backend: str = "analytic",
    ) -> None:
        """Build a robot; policy, motion generator, filters and backend are given by their names.

        The generator `servo` follows the moving target; others start when it is released.

        Raises:
            KinfeasError: If a part cannot be built, or the backend is no simulator.
        """
        config = load_section(ServoConfig, "servo", robot.folder)
        self.follows = generator == "servo"
        rules = replace(config.rules, max_jump=_UNLIMITED, max_turn=np.pi + 1e-3)
        limits: dict[str, object] = {**rules.generator_limits}
        if not self.follows:
            rules = replace(rules, max_velocity=_UNLIMITED, max_angular_velocity=_UNLIMITED)
        self._steps = 0
        spec = MotionSpec(generator, limits if self.follows else {})
        self.controller = TargetController(robot, rules, lambda: self.seconds, spec)
        self._solver = IkSolver(robot, config.ik)
        self.backend = build_simulator(backend, config.backend, robot=robot, scene=scene)
        with closed_on_error(self.backend):
            self.loop = assemble(
                self._solver, build_subgoals(self.controller.subgoals), self.backend, dt=DT,
                execution=config, stream=self.controller, policy=load_policy(policy, robot),
                filters=(self.controller, *(PluginSpec(name) for name in filters)),
            )  # fmt: skip
            self.restart()

    @property
    def seconds(self) -> float:
        """Simulated time."""
        return self._steps * DT

    @property
    def base_pose(self) -> Array:
        """World pose of the base, shape (7,)."""
        return self.loop.true_state[0][0]

    @property
    def ee_pose(self) -> Array:
        """World pose of the EE, shape (7,)."""
        return self.loop.true_state[1][0]

    @property
    def joint_positions(self) -> Array:
        """Arm joints, shape (j,)."""
        return self.loop.robots.joint_positions[0]

    def restart(self) -> None:
        """Put the robot at the origin, with the arm at home."""
        rng = np.random.default_rng(0)
        start: Start = stacked([start_at_home(self._solver.robot)])
        self.loop.start(start, [rng])
        self._goal = self.ee_pose
        self.feasible, self.deviation = True, 0.0
        self.joint_speeds = np.zeros(len(self._solver.robot.arm))

    def step(self, target: Array, *, held: bool = False) -> None:
        """Advance by `DT` toward a target (7,); other generators than `servo` wait while `held`."""
        begins = not self.follows and not held and not np.array_equal(target, self._goal)
        if self.follows or begins:
            self._goal = target.copy()
        metres, radians = spatial.distance(self.loop.desired[0], self._goal)
        if metres > _NEAR[0] or radians > _NEAR[1]:  # without a new target the base comes to rest
            self.controller.set_target(self._goal)
        before = self.joint_positions.copy()
        outcome = self.loop.step()
        if begins:
            self.loop.sequence.begin_again(np.zeros(1, dtype=np.intp))
        self._steps += 1
        self.feasible, self.deviation = bool(outcome.feasible[0]), float(outcome.deviation[0])
        robot = self._solver.robot
        moved = np.abs(joint_displacement(robot, before, self.joint_positions))
        self.joint_speeds = moved / DT / robot.max_joint_velocity

    def close(self) -> None:
        """End the simulation."""
        self.backend.close()
