"""Episodes of one policy in the PyBullet world, and their records."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kinfeas.backends.pybullet.stage import Stage
from kinfeas.control.adapters import execution_of, wrap
from kinfeas.control.execution import ExecutionConfig
from kinfeas.control.loop import Rows
from kinfeas.core import registry
from kinfeas.core.metrics import EpisodeRecords
from kinfeas.core.policy import Policy
from kinfeas.envs.physics import PhysicsSettings, make_physics_world, make_stage
from kinfeas.envs.world import Transition, World
from kinfeas.evaluation.episodes import Watch, run_episodes
from kinfeas.evaluation.physics.collisions import Encounters
from kinfeas.robots.robot import Robot
from kinfeas.tasks.task import Task

ROWS = 8
"""PyBullet worlds in a process; no figure depends on it."""


@dataclass(frozen=True)
class PhysicsTrial:
    """What a policy is put to.

    Attributes:
        robot: Who moves.
        task: Draws the episodes.
        episodes: How many, at least 1: numbers 0 to `episodes` - 1 of the seed.
        seed: Of all episodes.
        settings: Everything else.
    """

    robot: Robot
    task: Task
    episodes: int = 50
    seed: int = 1
    settings: PhysicsSettings = field(default_factory=PhysicsSettings)

    @property
    def execution(self) -> ExecutionConfig:
        """How the EE motions are carried out, with what the adapters make of it.

        Raises:
            KinfeasError: If an adapter cannot be built, or fails.
        """
        backend = registry.build("kinfeas.backends", "analytic", {})
        return execution_of(
            wrap(backend, self.settings.adapters, self.robot), self.settings.execution
        )


@dataclass(frozen=True)
class PhysicsRecords(EpisodeRecords):
    """What happened in n episodes with physics.

    Attributes:
        done: Whether the objects ended as the task wants them, shape (n,); whether the goal was
            reached where the task wants nothing of objects, or there are none.
        base_collisions: How often the base ran into a thing of the scene, shape (n,); a thing
            counts again once it has not been touched for half a second.
        arm_collisions: How often the arm did, shape (n,).
    """

    done: NDArray[np.bool_]
    base_collisions: NDArray[np.intp]
    arm_collisions: NDArray[np.intp]


class PhysicsWorld:
    """A task in PyBullet worlds, some episodes side by side.

    Attributes:
        stage: The task and what stands around.
        world: The loop and its ends of episodes.
    """

    def __init__(self, trial: PhysicsTrial, *, gui: bool = False) -> None:
        """Build the world of a trial, and show it in a window if `gui`.

        Raises:
            KinfeasError: If PyBullet is not installed, or the task's scene is broken.
        """
        settings = trial.settings
        self.stage = make_stage(trial.robot, trial.task, settings, gui=gui)
        self.world = make_physics_world(
            trial.robot, self.stage, settings.world, settings.execution, trial.seed
        )

    def run(
        self,
        policy: Policy,
        episodes: range,
        on_done: Callable[[int], None] | None = None,
        watch: Watch | None = None,
    ) -> PhysicsRecords:
        """Return what happens in the episodes of a range; other arguments as in `run_episodes`."""
        metrics = _TaskMetrics(self.stage, self.world.loop.dt, episodes, watch)
        records = run_episodes(
            self.world, policy, len(episodes), on_done, metrics, episodes.start, ROWS
        )
        done = metrics.done if self.stage.judges else records.reached
        return PhysicsRecords(
            **vars(records),
            done=done,
            base_collisions=metrics.base_collisions,
            arm_collisions=metrics.arm_collisions,
        )

    def close(self) -> None:
        """End the world; it may be called twice."""
        self.stage.backend.close()


class _TaskMetrics:
    """Counts what base and arm run into, and checks the task's objects as each episode ends."""

    def __init__(self, stage: Stage, dt: float, episodes: range, watch: Watch | None) -> None:
        self._stage, self._dt, self._first, self._watch = stage, dt, episodes.start, watch
        self._encounters: dict[int, tuple[Encounters, Encounters]] = {}
        self.done = np.zeros(len(episodes), dtype=np.bool_)
        self.base_collisions, self.arm_collisions = np.zeros((2, len(episodes)), dtype=np.intp)

    def __call__(self, world: World, transition: Transition, rows: Rows, episodes: Rows) -> None:
        if self._watch is not None:
            self._watch(world, transition, rows, episodes)
        for row, episode in zip(rows.tolist(), (episodes - self._first).tolist(), strict=True):
            if episode not in self._encounters:
                self._encounters[episode] = Encounters(self._dt), Encounters(self._dt)
            base, arm = self._encounters[episode]
            now = self._stage.backend.sims[row].touched()
            base.add(now.base)
            arm.add(now.arm)
            if transition.done[row]:
                self.base_collisions[episode], self.arm_collisions[episode] = base.count, arm.count
                if self._stage.judges:
                    state = world.loop.state.true_state or world.loop.state
                    self._stage.settle(state.joint_positions, self._dt, row)
                    self.done[episode] = self._stage.done(row)
