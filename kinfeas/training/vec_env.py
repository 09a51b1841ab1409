"""The world as Stable-Baselines3 sees it."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from kinfeas.control import observation
from kinfeas.control.drive import action_size
from kinfeas.core.errors import KinfeasError
from kinfeas.envs.interface import read_actions
from kinfeas.envs.world import World
from kinfeas.robots.robot import Robot
from kinfeas.training.batch import Batch, StepResult


class EpisodesVecEnv(VecEnv):
    """Episodes of one robot that restart by themselves, wherever they happen.

    Attributes:
        robot: Who moves.
        scale: Factors of the observations, shape (d,).
    """

    render_mode = None

    def __init__(self, robot: Robot, num_envs: int) -> None:
        """Set the spaces of `num_envs` episodes."""
        super().__init__(
            num_envs,
            spaces.Box(-np.inf, np.inf, (observation.size(robot),), np.float32),
            spaces.Box(-1.0, 1.0, (action_size(robot.base),), np.float32),
        )
        self.robot = robot
        self.scale = observation.scale(robot).astype(np.float32)

    @abstractmethod
    def reset(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""

    @abstractmethod
    def step_wait(self) -> StepResult:
        """Return observations, rewards, dones and infos; where done, a new episode has begun."""

    @abstractmethod
    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that can be gone on from, by name; a step under way ends first."""

    @abstractmethod
    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Go on from what `snapshot` returned; return the observations, shape (n, d).

        Raises:
            ValueError: If the snapshot is of another number of environments.
        """

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute once for each of the asked-for environments."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the environments are one."""
        raise NotImplementedError("the environments of a world share their attributes")

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: the environments are one."""
        raise NotImplementedError("the environments of a world have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each of the asked-for environments."""
        return [False for _ in self._get_indices(indices)]


class WorldVecEnv(EpisodesVecEnv):
    """n episodes in one world, which moves in a thread of its own; see `Batch`."""

    def __init__(self, world: World, num_envs: int, action_repeat: int = 1) -> None:
        """Put `num_envs` episodes into `world`; an action holds for `action_repeat` periods.

        Raises:
            KinfeasError: If `num_envs` is less than 1.
        """
        if num_envs < 1:
            raise KinfeasError(f"num_envs must be at least 1, not {num_envs}")
        super().__init__(world.robot, num_envs)
        self.world, self.batch = world, Batch(world, num_envs, action_repeat)
        self._worker = ThreadPoolExecutor(1)
        self._coming: Future[StepResult] | None = None

    def reset(self) -> NDArray[np.float32]:
        """Begin fresh episodes everywhere and return their observations, shape (n, d)."""
        return self.batch.start()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Begin a step with the actions, shape (n, a).

        Raises:
            KinfeasError: If the actions are of another shape or not finite.
        """
        commands = read_actions(actions, (self.num_envs, self.world.action_size))
        # A copy, for whoever asked may change the actions meanwhile.
        self._coming = self._worker.submit(self.batch.step, commands.copy())

    def step_wait(self) -> StepResult:
        """Return observations, rewards, dones and infos; where done, a new episode has begun."""
        if self._coming is None:
            raise RuntimeError("step_wait needs a step_async before it")
        coming, self._coming = self._coming, None
        return coming.result()

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Return everything that the episodes go on from, by name; a step under way ends first."""
        if self._coming is not None:
            self._coming.result()
        return self.batch.snapshot()

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Go on from what `snapshot` returned; return the observations, shape (n, d)."""
        return self.batch.restore(snapshot)

    def close(self) -> None:
        """Close the world's backend; a step under way ends first."""
        self._worker.shutdown()
        self.world.loop.backend.close()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Use another seed from the next reset on."""
        if seed is not None:
            self.world.seed, self.batch.next_episode = seed, 0
        return [seed] * self.num_envs
