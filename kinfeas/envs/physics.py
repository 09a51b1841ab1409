"""The PyBullet world: its settings, and the MDP in it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from kinfeas.backends.pybullet.backend import PyBulletBackend
from kinfeas.backends.pybullet.physics import PhysicsConfig
from kinfeas.backends.pybullet.stage import Stage, task_scene
from kinfeas.config import Interval, PluginSpec
from kinfeas.config.quantities import PositiveSeconds
from kinfeas.config.recipes import load_section
from kinfeas.control.execution import ExecutionConfig, ExecutionSettings
from kinfeas.envs.world import World, WorldConfig
from kinfeas.kinematics.ik import IkOptions
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import Task


@dataclass(frozen=True)
class PhysicsChanges(ExecutionSettings):
    """What is different where there is physics, beside the loop and its ends of episodes.

    Attributes:
        objects: Whether the task's scene is there, or a floor and nothing else.
        physics: Numbers of the world.
    """

    objects: bool = True
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)


@dataclass(frozen=True)
class PhysicsSettings(PhysicsChanges):
    """What can be set of the PyBullet world beside robot and task.

    Attributes:
        dt: Control period, seconds.
        max_failures: Kinematic failures in one episode beyond which it ends.
        max_seconds: Of motion time in one sub-goal, after which an episode is truncated.
        adapters: Wrapped around the PyBullet world, the first one innermost.
        filters: Change the policy's commands, in this order.
        ik: How hard IK searches.
    """

    dt: Annotated[float, Interval(low=0.001, high=1.0)] = 0.02
    max_failures: Annotated[int, Interval(low=0)] = 99
    max_seconds: PositiveSeconds = 150.0
    adapters: tuple[PluginSpec, ...] = ()
    filters: tuple[PluginSpec, ...] = ()
    ik: IkOptions = field(default_factory=IkOptions)

    @property
    def world(self) -> WorldConfig:
        """What the loop's world is made of."""
        return WorldConfig(
            self.dt,
            self.max_failures,
            self.max_seconds,
            self.adapters,
            ik=self.ik,
            filters=self.filters,
        )


@dataclass(frozen=True)
class PhysicsEvaluationConfig:
    """What can be set of an evaluation with physics beside what it evaluates.

    Attributes:
        task: Keyword parameters of the task.
        world: Where the episodes happen.
    """

    task: dict[str, object] = field(default_factory=dict)
    world: PhysicsSettings = field(default_factory=PhysicsSettings)


def make_stage(robot: Robot, task: Task, settings: PhysicsChanges, *, gui: bool = False) -> Stage:
    """Return a task with a PyBullet world around it, in a window if `gui`.

    Raises:
        KinfeasError: If PyBullet is not installed, or the task's scene is broken.
    """
    scene = task_scene(task) if settings.objects else None
    return Stage(task, PyBulletBackend(robot, scene, gui=gui, physics=settings.physics))


def make_physics_world(
    robot: Robot, stage: Stage, config: WorldConfig, execution: ExecutionConfig, seed: int
) -> World:
    """Return the loop and its ends of episodes on a stage."""
    return World(robot, stage, config, seed, stage.backend, execution)


def physics_config(robot: Robot, overrides: Sequence[str] = ()) -> PhysicsEvaluationConfig:
    """Return what suits a robot, with assignments such as `world.time_scale=1`.

    Raises:
        KinfeasError: If one of them is not allowed.
    """
    return load_section(PhysicsEvaluationConfig, "pybullet", robot.name, overrides)
